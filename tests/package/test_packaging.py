"""Claims about the wheel: what is in it, and that it works without the checkout."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest
import yaml
from repository import ROOT, SCENES

TEMPLATES = ROOT / "multiarm" / "reports" / "templates"
SCENE = SCENES / "corner_grippers_block.yaml"  # robots of this project only


def built(source: Path, folder: Path) -> Path:
    """The wheel of a checkout, built into a folder."""
    command = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir"]
    result = subprocess.run([*command, folder, source], capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stdout + result.stderr
    (path,) = folder.glob("multiarm-*.whl")
    return path


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    return built(ROOT, tmp_path_factory.mktemp("wheel"))


@pytest.fixture(scope="module")
def contents(wheel) -> set[str]:
    return set(zipfile.ZipFile(wheel).namelist())


@pytest.fixture(scope="module")
def unpacked(wheel, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    zipfile.ZipFile(wheel).extractall(folder)
    return folder


@pytest.fixture
def elsewhere(unpacked, tmp_path, monkeypatch):
    """Run Python in an empty folder with the wheel in place of the checkout."""
    monkeypatch.chdir(tmp_path)
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("NUMBA_", "PYTHON"))}
    environment |= {"PYTHONPATH": str(unpacked)}  # found before any installed multiarm

    def run(*words: object) -> str:
        command = [sys.executable, *map(str, words)]
        result = subprocess.run(
            command, env=environment, capture_output=True, text=True, check=False
        )
        assert result.returncode == 0, result.stdout + result.stderr
        return result.stdout

    return run


@pytest.mark.slow
def test_wheel_holds_every_module_and_nothing_of_the_tests(contents):
    modules = {str(p.relative_to(ROOT)) for p in (ROOT / "multiarm").rglob("*.py")}
    assert {name for name in contents if name.endswith(".py")} == modules


@pytest.mark.slow
def test_wheel_holds_the_robots_with_their_sources(contents):
    files = [path for path in (ROOT / "robots").rglob("*") if path.is_file()]
    expected = {f"multiarm/robot_files/{path.relative_to(ROOT / 'robots')}" for path in files}
    assert {name for name in contents if name.startswith("multiarm/robot_files/")} == expected
    folders = {path.parent for path in files if path.suffix == ".urdf"}
    assert folders
    assert all((folder / "SOURCE.md").is_file() for folder in folders)


def test_wheel_holds_every_template_of_a_page(contents):
    templates = {str(p.relative_to(ROOT)) for p in TEMPLATES.iterdir()}
    assert {Path(name).suffix for name in templates} == {".html", ".css", ".js"}
    assert templates <= contents


@pytest.mark.slow
def test_source_archive_holds_every_template_of_a_page(tmp_path):
    command = [
        sys.executable,
        "-m",
        "build",
        "--sdist",
        "--no-isolation",
        "--outdir",
        tmp_path,
        ROOT,
    ]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stdout + result.stderr
    (built,) = tmp_path.glob("multiarm-*.tar.gz")
    with tarfile.open(built) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    assert {str(p.relative_to(ROOT)) for p in TEMPLATES.iterdir()} <= names


@pytest.mark.slow
def test_wheel_is_the_same_byte_by_byte_wherever_and_whenever_it_is_built(wheel, tmp_path):
    """A copy of the checkout whose files have other times and permissions."""
    source = tmp_path / "elsewhere"
    shutil.copytree(
        ROOT, source, copy_function=shutil.copyfile,
        ignore=shutil.ignore_patterns(".git", "__pycache__", ".*_cache", "docs", "tests"),
    )  # fmt: skip
    for path in source.rglob("*"):
        if path.is_file():
            os.utime(path, (1e9, 1e9))
            path.chmod(0o600)
    assert built(source, tmp_path / "wheel").read_bytes() == wheel.read_bytes()


def test_wheel_says_that_it_has_types(contents):
    assert "multiarm/py.typed" in contents


def test_workflow_runs_the_commands_of_the_readme_on_every_supported_python():
    text = (ROOT / ".github" / "workflows" / "tests.yml").read_text(encoding="utf-8")
    job = yaml.safe_load(text)["jobs"]["readme"]
    commands = re.findall(r"```bash\n(.*?)\n```", (ROOT / "README.md").read_text(), re.DOTALL)
    assert [step["run"] for step in job["steps"] if "run" in step] == commands
    least = re.search(r'requires-python = ">=([\d.]+)"', (ROOT / "pyproject.toml").read_text())
    assert job["strategy"]["matrix"]["python"][0] == least[1]


def test_wheel_holds_the_licence(contents):
    assert any(name.endswith(".dist-info/licenses/LICENSE") for name in contents)


def test_wheel_has_no_other_files(contents):
    kinds = {Path(name).suffix for name in contents if name.startswith("multiarm/")}
    assert kinds == {".py", ".html", ".css", ".js", ".urdf", ".md", ".typed"}
    outside = {name for name in contents if not name.startswith("multiarm/")}
    assert all(name.split("/")[0].endswith(".dist-info") for name in outside)


def test_wheel_installs_the_command(wheel, contents):
    (name,) = [name for name in contents if name.endswith(".dist-info/entry_points.txt")]
    assert "multiarm = multiarm.cli:main" in zipfile.ZipFile(wheel).read(name).decode()


def test_unpacked_wheel_is_what_is_imported(elsewhere, unpacked):
    printed = elsewhere("-c", "import multiarm; print(multiarm.__file__)")
    assert Path(printed.strip()) == unpacked / "multiarm" / "__init__.py"


@pytest.mark.slow
def test_check_runs_from_the_wheel_with_its_own_robots(elsewhere, unpacked, tmp_path):
    """With the checkout's compiled kernels, as far as there are some: the sources are the same."""
    for path in (ROOT / "multiarm").rglob("*.nb[ci]"):
        place = unpacked / path.relative_to(ROOT)
        place.parent.mkdir(exist_ok=True)
        shutil.copy(path, place)
    shutil.copy(SCENE, tmp_path)
    elsewhere("-m", "multiarm", "check", SCENE.name, "--json", "facts.json")
    facts = json.loads((tmp_path / "facts.json").read_text(encoding="utf-8"))
    robots = unpacked / "multiarm" / "robot_files"
    assert {arm["tool"] for arm in facts["arms"].values()} == {"corner_gripper"}
    for arm in facts["arms"].values():
        assert Path(arm["urdf"]) == robots / "textbook_6r" / "textbook_6r.urdf"
