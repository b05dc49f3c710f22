"""What must hold for the repository as a whole, whatever is built in it."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from rooms import MODULES, ROOMS, ROOT

import cyclofeat

PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


def source_files() -> list[Path]:
    """Every file that git holds or would take up."""
    if shutil.which("git") is None or not (ROOT / ".git").exists():
        pytest.skip("not a git checkout: there is no list of the files that belong to it")
    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    names = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    return [path for name in names.split("\0") if name and (path := ROOT / name).is_file()]


def test_every_place_states_the_same_version():
    version = cyclofeat.__version__
    assert PYPROJECT["project"]["version"] == version
    assert f"\nversion: {version}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    recipe = (ROOT / "packaging" / "conda" / "recipe.yaml").read_text(encoding="utf-8")
    assert f'version: "{version}"\n' in recipe
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    _, unreleased, newest, *_ = re.split(r"^## ", changes, flags=re.MULTILINE)
    assert unreleased.startswith("[Unreleased]\n")
    assert re.match(rf"\[{re.escape(version)}\] - \d{{4}}-\d\d-\d\d\n", newest)
    assert "\n- " in newest


def test_every_folder_with_code_is_in_the_wheel():
    # The list of packages is written by hand, because of the mapped folders: a new one is easily forgotten.
    found = {name for name, file in MODULES.items() if file.name == "__init__.py"}
    assert found == set(PYPROJECT["tool"]["setuptools"]["packages"])


@pytest.mark.parametrize(
    ("pattern", "meaning"),
    [
        (r"(?<![\w.$}/-])/(?:work|root|home|Users|tmp)/", "a path of somebody's machine"),
        (r"^(?:<{7}|>{7}) ", "a merge conflict"),
        (r"index[-_]url", "a package registry"),
        (r"pip install ['\"]?cyclofeat\b", "advice to install what is on no index"),
        # Python in the checkout would find its folder cyclofeat, without the rooms that are mapped into it.
        (r"pip install ['\"]\.", "advice to install the checkout without -e"),
    ],
)
def test_no_file_holds(pattern, meaning):
    found = []
    for path in source_files():
        try:
            text = path.read_text(encoding="utf-8")
        except UnicodeDecodeError:
            continue  # data, not text
        for match in re.finditer(pattern, text, flags=re.MULTILINE):
            found.append(f"{path.relative_to(ROOT)}:{text.count(chr(10), 0, match.start()) + 1}")
    assert not found, f"{meaning} in {found}"


def test_shipped_data_say_whose_they_are():
    code = {".py", ".pyc", ".nbi", ".nbc"}
    files = (path for path in (ROOT / "datasets").rglob("*") if path.is_file() and path.suffix not in code)
    bare = {
        str(folder.relative_to(ROOT))
        for folder in {path.parent for path in files}
        if not [*folder.glob("README*"), *folder.glob("LICENSE*")]
    }
    assert not bare, f"data without README or LICENSE beside them: {sorted(bare)}"


def test_the_stated_licence_is_that_of_all_that_is_in_the_wheel():
    project, tools = PYPROJECT["project"], PYPROJECT["tool"]["setuptools"]
    shipped = {
        path.parent
        for package, patterns in tools["package-data"].items()
        for room in [max((name for name in ROOMS if package.startswith(name)), key=len)]
        for pattern in patterns
        for path in (ROOMS[room] / package.removeprefix(room).strip(".").replace(".", "/")).glob(pattern)
        if path.name != "README.md"  # of the project itself; the data that it describes may be in no wheel
    }
    assert ROOT / "datasets" / "jelmerv_cycloidal" in shipped
    texts = [ROOT / "LICENSE", *(text for folder in shipped for text in folder.glob("LICENSE*"))]
    assert {ROOT / name for name in project["license-files"]} == set(texts)
    names = {"BSD 3-Clause License": "BSD-3-Clause", "CC BY-SA 4.0": "CC-BY-SA-4.0", "The MIT License": "MIT"}
    stated = {
        spdx for text in texts for name, spdx in names.items() if name in text.read_text(encoding="utf-8")
    }
    assert project["license"] == " AND ".join(sorted(stated))


@pytest.mark.slow
def test_import_loads_nothing_heavy(tmp_path, record_property):
    # Which modules are loaded is asserted, not how long it takes: a busy machine would fail for no reason.
    code = (
        "import sys, time; before = time.perf_counter(); import cyclofeat;"
        "print(time.perf_counter() - before, *sys.modules);"
        "import cyclofeat.plotting, cyclofeat.report; print(*sys.modules);"
        "import cyclofeat.datasets; print(*sys.modules)"
    )
    run = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    (seconds, *modules), with_pages, with_datasets = (line.split() for line in run.stdout.splitlines())
    record_property("cold_import_s", float(seconds))
    print(f"cold import: {float(seconds):.3f} s")
    heavy = {"numba", "sklearn", "matplotlib", "scipy.signal", "pandas", "pywt", "cyclofeat.simulators"}
    assert not heavy & set(modules)
    assert not {"matplotlib", "jinja2", "numba", "cyclofeat.simulators"} & set(with_pages)
    assert "numba" not in with_datasets


def test_the_conda_recipe_states_what_pyproject_states():
    text = (ROOT / "packaging" / "conda" / "recipe.yaml").read_text(encoding="utf-8")
    project = PYPROJECT["project"]
    run = text.partition("  run:\n")[2].partition("\n\n")[0]
    stated = {line.strip(" -").replace(" ", "") for line in run.splitlines()}
    wanted = {"python>=${{python_min}}", *(one.lower() for one in project["dependencies"])}
    assert stated == wanted
    assert f'python_min: "{project["requires-python"].removeprefix(">=")}"\n' in text
    assert f"license: {project['license']}\n" in text
    for name, entry in project["scripts"].items():
        assert f"- {name} = {entry}\n" in text


def test_every_tested_python_is_stated_everywhere():
    versions = PYPROJECT["tool"]["tox"]["env_list"]
    workflow = (ROOT / ".github" / "workflows" / "check.yml").read_text(encoding="utf-8")
    assert f"python: [{', '.join(map(repr, versions))}]".replace("'", '"') in workflow
    stated = [c.rpartition(" ")[2] for c in PYPROJECT["project"]["classifiers"] if ":: Python :: 3." in c]
    assert stated == versions


def test_a_public_host_finds_its_files():
    here = ["CODE_OF_CONDUCT.md", "CONTRIBUTING.md", "SECURITY.md", ".github/pull_request_template.md"]
    templates = list((ROOT / ".github" / "ISSUE_TEMPLATE").iterdir())
    for path in (*(ROOT / name for name in here), *templates):
        assert path.read_text(encoding="utf-8").strip(), path
    assert {path.suffix for path in templates} == {".yml"}
    publish = (ROOT / ".github" / "workflows" / "publish.yml").read_text(encoding="utf-8")
    assert 'on:\n  push: {tags: ["v*"]}\n' in publish


def test_hooks_use_the_ruff_of_the_checks():
    hooks = (ROOT / ".pre-commit-config.yaml").read_text(encoding="utf-8")
    (pin,) = [one for one in PYPROJECT["project"]["optional-dependencies"]["lint"] if one.startswith("ruff")]
    assert f"rev: v{pin.removeprefix('ruff==').removesuffix('*')}" in hooks


def test_names_of_files_suit_every_system():
    names = [path.relative_to(ROOT).as_posix() for path in source_files()]
    assert len({name.lower() for name in names}) == len(names)
    bad = re.compile(r'[<>:"|?*\\]|(^|/)(con|prn|aux|nul|com\d|lpt\d)(\.|/|$)|[. ](/|$)', re.IGNORECASE)
    assert not [name for name in names if bad.search(name)]
