"""The documentation names every command, option, configuration key, equation, check and topic."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel

from istc_replay.cli import cli
from istc_replay.config import Config, parse_config, render_config
from istc_replay.datatypes import Result
from istc_replay.safety.certificate import certify

ROOT = Path(__file__).resolve().parents[1]
DOCS = {path.name: path.read_text(encoding="utf-8") for path in (ROOT / "docs").glob("*.md")}
README = (ROOT / "README.md").read_text(encoding="utf-8")


def keys(model: Any, prefix: str = "") -> Iterator[str]:
    """Every key of the configuration, by its dotted path."""
    for name, field in model.model_fields.items():
        inner = [
            t for t in (field.annotation, *getattr(field.annotation, "__args__", ())) if isinstance(t, type)
        ]
        nested = [t for t in inner if issubclass(t, BaseModel)]
        if nested:
            yield from keys(nested[0], f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}"


def test_every_command_is_in_the_readme() -> None:
    for name in cli.commands:
        assert f"istc-replay {name}" in README


def test_every_module_of_the_package_itself_is_in_the_architecture() -> None:
    package = ROOT / "istc_replay"
    names = [path.name for path in package.glob("*.py") if not path.name.startswith("__")]
    names += [f"{path.parent.name}/" for path in package.glob("*/__init__.py")]
    assert [name for name in names if f"`{name}`" not in DOCS["architecture.md"]] == []


@pytest.mark.parametrize("equation", range(1, 20))
def test_every_equation_has_a_row(equation: int) -> None:
    row = next(line for line in DOCS["equations.md"].splitlines() if line.startswith(f"| ({equation}) |"))
    assert row.count("|") == 6


def test_every_function_and_test_that_the_equations_name_exists() -> None:
    rows = [line for line in DOCS["equations.md"].splitlines() if re.match(r"\| \(\d+\)", line)]
    sources = "\n".join(path.read_text() for path in (ROOT / "istc_replay").rglob("*.py"))
    for row in rows:
        where, test = row.split("|")[3:5]
        for name in re.findall(r"`(\w+)\.(\w+)`", where):
            module, thing = name
            found = (ROOT / "istc_replay").rglob(f"{module}.py")
            packages = (ROOT / "istc_replay" / module).is_dir()
            assert packages or any(
                re.search(rf"(def|class) {thing}\b", path.read_text()) for path in found
            ), name
        for name in re.findall(r"`(\w+)`", where):
            assert (
                re.search(rf"(def|class) {name}\b", sources) or (ROOT / "istc_replay" / f"{name}.py").exists()
            )
        assert (ROOT / test.split("(")[0].strip()).exists(), test


def test_every_rule_of_recorded_traffic_names_tests_that_exist() -> None:
    rules = (
        DOCS["method.md"].partition("## Recorded traffic")[2].partition("### What coordination changed")[0]
    )
    told = DOCS["equations.md"].partition("## Rules of recorded traffic")[2]
    numbers = re.findall(r"^(\d+)\. \*\*", rules, flags=re.MULTILINE)
    rows = {
        row.split("|")[1].strip(): row.split("|")[4] for row in told.splitlines() if re.match(r"\| \d+ ", row)
    }
    # The last tells only what is not done.
    assert list(rows) == [str(n) for n in range(1, len(rows) + 1)]
    assert set(rows) >= {n for n in numbers if int(n) <= 10}
    for row in rows.values():
        for file, names in re.findall(r"(tests/\S+\.py) ((?:`test_\w+`(?:, )?)+)", row):
            source = (ROOT / file).read_text()
            for name in re.findall(r"`(test_\w+)`", names):
                assert f"def {name}(" in source, (file, name)
        assert "`test_" in row


def test_every_key_of_the_configuration_is_explained() -> None:
    text = render_config(Config(), explain=True)
    for key in keys(Config):
        section, name = key.split(".")[0], key.split(".")[-1]
        assert f"[{section}" in text
        model: Any = Config
        for part in key.split("."):
            field = model.model_fields[part]
            assert field.description, key
            arguments = (field.annotation, *getattr(field.annotation, "__args__", ()))
            model = next((t for t in arguments if isinstance(t, type) and issubclass(t, BaseModel)), None)
        assert name
    assert parse_config(text) == Config()


def test_configuration_keys_that_the_docs_name_exist() -> None:
    known = set(keys(Config))
    for name, text in {**DOCS, "README.md": README}.items():
        for key in re.findall(
            r"`((?:ingest|window|vehicles|guidance|corridors|trajectories|certificate|view)\.\w+)`", text
        ):
            assert key in known or key.split(".")[1] in (
                "collocation",
                "nlp",
                "plan",
                "walls",
                "topics",
                "by_id",
                "rrd",
            ), (
                name,
                key,
            )


def test_the_checks_that_the_docs_list_are_the_certificates(synthetic_result: Result) -> None:
    made = {certificate.check for certificate in certify(synthetic_result, Config())}
    listed = set(re.findall(r"^\| (\w+) \|", DOCS["audit.md"], re.MULTILINE)) - {"check"}
    assert listed == made


def test_every_topic_of_a_result_is_documented() -> None:
    sources = "\n".join(path.read_text() for path in (ROOT / "istc_replay" / "export").glob("*.py"))
    for topic in set(re.findall(r'"(/istc/\w+|/tf)', sources)):
        assert topic in DOCS["formats.md"], topic


def test_links_between_the_pages_lead_somewhere() -> None:
    for name, text in DOCS.items():
        for target in re.findall(r"\]\(([^)#]+)", text):
            if not target.startswith("http"):
                assert (ROOT / "docs" / target).exists(), (name, target)
    for target in re.findall(r"\]\(([^)#]+)", README):
        if not target.startswith("http"):
            assert (ROOT / target).exists(), target


def test_every_maker_of_tests_is_told() -> None:
    told = DOCS["architecture.md"].partition("\n## Tests\n")[2]
    made = {file.stem for file in (ROOT / "tests" / "support").glob("*.py")}
    assert (
        set(re.findall(r"`(\w+)`", "".join(re.findall(r"^\| (`.*?) \|", told, flags=re.MULTILINE)))) == made
    )
