"""The house: import directions, return types, modules that say what they are, plain ASCII sources."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
MODULES = sorted((ROOT / "thermofit").rglob("*.py"))


Function = ast.FunctionDef | ast.AsyncFunctionDef


def name_of(path: Path) -> str:
    return str(path.relative_to(ROOT))


def functions(path: Path) -> Iterator[Function]:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, Function):
            yield node


def lint_imports(folder: Path) -> subprocess.CompletedProcess[str]:
    """Check the import contract of pyproject.toml in a folder."""
    code = "import sys; from importlinter.cli import lint_imports; sys.exit(lint_imports(no_cache=True))"
    return subprocess.run([sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, check=False)


def test_import_contract() -> None:
    result = lint_imports(ROOT)
    assert result.returncode == 0, result.stdout + result.stderr


@pytest.mark.parametrize(
    ("module", "line", "broken"),
    [
        ("body/wrong.py", "import thermofit.observe", "Imports only go down"),
        ("fit/wrong.py", "import thermofit.read", "Imports only go down"),
        ("read/wrong.py", "import thermofit.fit", "Imports only go down"),
        ("read/wrong.py", "import thermofit.virtual", "Imports only go down"),
        ("observe/wrong.py", "import thermofit.read", "Imports only go down"),
        ("point/wrong.py", "import thermofit.body", "Imports only go down"),
        ("law/wrong.py", "import thermofit.point", "Imports only go down"),
        ("records/wrong.py", "import thermofit.effects", "Imports only go down"),
        ("study/wrong.py", "import thermofit.records", "Imports only go down"),
        ("study/wrong.py", "import thermofit.law", "Imports only go down"),
        ("law/hardening/wrong.py", "import thermofit.effects", "Hardening laws rest on core"),
        ("law/hardening/wrong.py", "import numba", "Hardening laws rest on core"),
        ("fit/wrong.py", "import thermofit.body", "never finite elements"),
        ("read/wrong.py", "import h5py", "HDF5"),
        ("stages/one.py", "import thermofit.stages.two", "Stages do not import"),
        ("stages/one.py", "import h5py", "HDF5"),
        ("plots/__init__.py", "", "Imports only go down"),
    ],
)
def test_import_contract_bites(tmp_path: Path, module: str, line: str, broken: str) -> None:
    """In a skeleton of the house one wrong import breaks the contract that forbids it."""
    (tmp_path / "pyproject.toml").write_text((ROOT / "pyproject.toml").read_text(encoding="utf-8"), encoding="utf-8")
    rooms = "stages report diagnose identify experiment fit virtual read observe body point law effects records study core".split()
    rooms.append("law/hardening")
    knows_hdf5 = ("records/artefact.py", "records/foreign_hdf5.py")
    for name in ("cli.py", *knows_hdf5, "stages/one.py", "stages/two.py", "__init__.py", *(f"{room}/__init__.py" for room in rooms)):
        path = tmp_path / "thermofit" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("import h5py\n" if name in knows_hdf5 else "", encoding="utf-8")
    assert lint_imports(tmp_path).returncode == 0
    wrong = tmp_path / "thermofit" / module
    wrong.parent.mkdir(exist_ok=True)
    wrong.write_text(line + "\n", encoding="utf-8")
    result = lint_imports(tmp_path)
    assert result.returncode != 0
    assert broken in result.stdout.split("Broken contracts")[-1], result.stdout


def test_functions_have_return_types() -> None:
    untyped = [f"{name_of(path)}: {node.name}" for path in MODULES for node in functions(path) if node.returns is None]
    assert untyped == []


def test_modules_say_what_they_are_in_ascii() -> None:
    texts = {name_of(path): path.read_text(encoding="utf-8") for path in MODULES}
    assert [name for name, text in texts.items() if not text.isascii()] == []
    assert [name for name, text in texts.items() if not ast.get_docstring(ast.parse(text))] == []
