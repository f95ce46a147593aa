"""The repository as a whole: locks, scripts, package, and nothing of one machine in it."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
LOCKS = ("requirements.lock", "requirements-test.lock")
SCRIPTS = ("replay", "test", "lock", "samples", "compile-schemas", "bench-ingest", "damage-table", "fuzz")
#: Written in pieces, so that this file does not hold what it looks for.
OF_ONE_MACHINE = re.compile(
    r"(?<![\w.])/(?:home|root|work|Users)/"
    r"|/tmp/[\w-]"
    r"|index-" + r"url|find-" + r"links"
    r"|https?://\S*(?:/simple\b|pypi\.|pythonhosted|\.whl\b|\.tar\.gz\b)"
)


def tracked_files() -> list[Path]:
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=False)
    if listed.returncode:
        pytest.skip("not a git checkout: nothing says which files are tracked")
    return [ROOT / name for name in listed.stdout.split("\0") if name and (ROOT / name).is_file()]


def pins(lock: str) -> dict[str, str]:
    """Pinned versions by normalised name."""
    text = (ROOT / lock).read_text(encoding="utf-8")
    found = re.findall(r"^([A-Za-z0-9][\w.-]*)==(\S+)", text, re.MULTILINE)
    return {normal(name): version for name, version in found}


def normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def names(requirements: list[str]) -> set[str]:
    """Normalised names of requirements such as `numpy>=2.0`."""
    return {normal(re.split(r"[^\w.-]", line, maxsplit=1)[0]) for line in requirements}


def test_no_tracked_file_names_a_path_or_registry_of_one_machine() -> None:
    found = []
    for path in tracked_files():
        try:
            lines = path.read_text(encoding="utf-8").splitlines()
        except UnicodeDecodeError:
            continue
        relative = path.relative_to(ROOT)
        for number, line in enumerate(lines, 1):
            if OF_ONE_MACHINE.search(line):
                found.append(f"{relative}:{number}: {line.strip()[:100]}")
    assert not found, "\n".join(found)


def test_no_tracked_file_is_larger_than_a_megabyte() -> None:
    assert [path.name for path in tracked_files() if path.stat().st_size > 1_000_000] == []


@pytest.mark.parametrize("lock", LOCKS)
def test_a_lock_holds_nothing_but_pins_with_hashes(lock: str) -> None:
    text = (ROOT / lock).read_text(encoding="utf-8")
    assert not re.search(r"^\s*--(?!hash=sha256:)", text, re.MULTILINE)
    assert "://" not in text
    entries = re.split(r"\n(?=\S)", re.sub(r"^#.*\n", "", text, flags=re.MULTILINE).strip())
    assert len(entries) > 20
    for entry in entries:
        assert re.match(r"^[\w.-]+==[\w.!+]+( ;[^\n]+)? \\\n", entry), entry[:80]
        assert "--hash=sha256:" in entry


def test_the_locks_cover_what_the_project_declares() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    runtime = names(project["project"]["dependencies"])
    build = names(project["build-system"]["requires"]) | {"editables"}
    assert runtime | build <= set(pins("requirements.lock")), "run scripts/lock"
    test = names(project["project"]["optional-dependencies"]["test"])
    assert test <= set(pins("requirements-test.lock")), "run scripts/lock"


def test_the_test_lock_pins_all_that_the_runtime_lock_pins() -> None:
    assert pins("requirements.lock").items() <= pins("requirements-test.lock").items()


@pytest.mark.parametrize("script", SCRIPTS)
def test_a_script_is_executable_and_parses(script: str) -> None:
    path = ROOT / "scripts" / script
    assert os.access(path, os.X_OK)
    subprocess.run(["bash", "-n", path], check=True)


def test_ci_runs_the_test_script() -> None:
    assert os.access(ROOT / ".ci/run", os.X_OK)
    assert "scripts/test" in (ROOT / ".ci/run").read_text(encoding="utf-8")


def test_the_readme_names_both_commands() -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert "scripts/replay" in readme
    assert "scripts/test" in readme


def test_the_wheel_builds_and_holds_the_package_alone(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", tmp_path]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    (wheel,) = tmp_path.glob("*.whl")
    held = set(zipfile.ZipFile(wheel).namelist())
    assert {"istc_replay/__init__.py", "istc_replay/py.typed", "istc_replay/data/istc_v1.binpb"} <= held
    assert "istc_replay/data/dense_4.json" in held
    assert {name.split("/")[0] for name in held if ".dist-info/" not in name} == {"istc_replay"}
    assert any(name.endswith("licenses/LICENSE") for name in held)
