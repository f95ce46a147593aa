"""Problems stay few, and stay on one line."""

from __future__ import annotations

from istc_replay.ingest.problems import Problems, quoted


def test_the_first_faults_of_a_kind_are_told_and_the_rest_counted() -> None:
    problems = Problems()
    for index in range(100):
        problems.add("payload", f"message {index}", index, "/a")
    problems.add("payload", "message 0", 7, "/b")
    found = problems.found()
    assert [(problem.detail, problem.offset) for problem in found] == [
        *((f"message {index}", index) for index in range(5)),
        ("95 more of this kind (/a)", None),
        ("message 0", 7),
    ]
    assert not problems.lost


def test_many_kinds_are_lumped_together() -> None:
    problems = Problems()
    for index in range(10_000):
        problems.lose("payload", f"on topic {index}", kind=str(index))
    assert len(problems.found()) < 100
    assert problems.lost


def test_quoted_text_has_no_control_characters_and_a_bounded_length() -> None:
    assert quoted("a\nb\x1b[31m") == r"'a\nb\x1b[31m'"
    assert len(quoted("x" * 1000)) <= 82
