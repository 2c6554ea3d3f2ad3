"""The house: import directions, return types, modules that say what they are, plain ASCII sources."""

from __future__ import annotations

import ast
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
ABOVE = ("export", "report", "diagnose", "identify", "stages", "cli")
"""Rooms above `experiment`."""
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


@pytest.fixture(scope="module")
def skeleton(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The rooms of the house without what is in them; they keep the contract."""
    folder = tmp_path_factory.mktemp("skeleton")
    (folder / "pyproject.toml").write_text((ROOT / "pyproject.toml").read_text(encoding="utf-8"), encoding="utf-8")
    rooms = "stages export report diagnose identify experiment fit virtual read observe body point law records study effects core".split()
    rooms += ["law/hardening", "law/surface"]
    knows_hdf5 = ("records/artefact.py", "records/foreign_hdf5.py")
    for name in (
        "__main__.py",
        "cli.py",
        "library.py",
        *knows_hdf5,
        "stages/one.py",
        "stages/two.py",
        "__init__.py",
        *(f"{room}/__init__.py" for room in rooms),
    ):
        path = folder / "thermofit" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("import h5py\n" if name in knows_hdf5 else "", encoding="utf-8")
    result = lint_imports(folder)
    assert result.returncode == 0, result.stdout + result.stderr
    return folder


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
        ("effects/wrong.py", "import thermofit.study", "Imports only go down"),
        ("study/wrong.py", "import thermofit.records", "Imports only go down"),
        ("study/wrong.py", "import thermofit.law", "Imports only go down"),
        ("law/hardening/wrong.py", "import thermofit.effects", "Hardening laws and yield surfaces rest on core"),
        ("law/hardening/wrong.py", "import numba", "Hardening laws and yield surfaces rest on core"),
        ("law/surface/wrong.py", "import numba", "Hardening laws and yield surfaces rest on core"),
        ("fit/wrong.py", "import thermofit.body", "never finite elements"),
        ("read/wrong.py", "import h5py", "HDF5"),
        ("stages/one.py", "import thermofit.stages.two", "Stages do not import"),
        ("stages/one.py", "import h5py", "HDF5"),
        ("plots/__init__.py", "", "Imports only go down"),
    ],
)
def test_import_contract_bites(skeleton: Path, tmp_path: Path, module: str, line: str, broken: str) -> None:
    """In a skeleton of the house one wrong import breaks the contract that forbids it."""
    shutil.copytree(skeleton, tmp_path, dirs_exist_ok=True)
    wrong = tmp_path / "thermofit" / module
    wrong.parent.mkdir(exist_ok=True)
    wrong.write_text(line + "\n", encoding="utf-8")
    result = lint_imports(tmp_path)
    assert result.returncode != 0
    assert broken in result.stdout.split("Broken contracts")[-1], result.stdout


def module_of(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports_of(tree: ast.AST, module: str, modules: frozenset[str]) -> set[str]:
    """Modules of the house that a source imports: at its top, inside its functions, and for types alone."""
    names = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            above = module.split(".")[: -node.level] if node.level else []
            base = ".".join([*above, *([node.module] if node.module else [])])
            whole = {f"{base}.{alias.name}" for alias in node.names}
            names |= (whole & modules) or {base}
    return (names & modules) - {module}


def circles(graph: dict[str, set[str]]) -> list[list[str]]:
    """Groups of modules that reach each other (Tarjan 1972, SIAM Journal on Computing 1, 146-160)."""
    number: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found: list[list[str]] = []

    def visit(v: str) -> None:
        number[v] = low[v] = len(number)
        stack.append(v)
        for w in graph[v]:
            if w not in number:
                visit(w)
                low[v] = min(low[v], low[w])
            elif w in stack:
                low[v] = min(low[v], number[w])
        if low[v] == number[v]:
            group = stack[stack.index(v) :]
            del stack[stack.index(v) :]
            if len(group) > 1:
                found.append(sorted(group))

    for v in graph:
        if v not in number:
            visit(v)
    return found


def test_no_circle_among_the_files() -> None:
    """None by an import inside a function, none by one that only types need."""
    modules = frozenset(map(module_of, MODULES))
    graph = {module_of(p): imports_of(ast.parse(p.read_text(encoding="utf-8")), module_of(p), modules) for p in MODULES}
    assert circles(graph) == []
    assert len(graph["thermofit.stages.run"]) > 3, "imports are found"


@pytest.mark.parametrize(
    "back",
    [
        *("from a.one import f", "import a.one", "from a import one", "from . import one", "from .one import f"),
        *("def f():\n    from a.one import f", "if TYPE_CHECKING:\n    import a.one"),
    ],
)
def test_circles_are_seen(back: str) -> None:
    sources = {"a": "", "a.one": "from a.two import g", "a.two": back, "a.three": "import a.one"}
    graph = {name: imports_of(ast.parse(text), name, frozenset(sources)) for name, text in sources.items()}
    assert circles(graph) == [["a.one", "a.two"]]


def test_one_place_asks_what_kind_of_study_it_is() -> None:
    """All others ask the Experiment that it makes; what is below has it from the study."""
    asking = [name_of(p) for p in MODULES if re.search(r"study\.coupon is|isinstance\(data", p.read_text(encoding="utf-8"))]
    assert asking == ["thermofit/experiment/forms.py"]
    forms = re.compile(r"BodyExperiment|CouponExperiment|SeveralExperiments")
    knowing = [p for room in ABOVE for p in (ROOT / "thermofit" / room).rglob("*.py") if forms.search(p.read_text(encoding="utf-8"))]
    assert knowing == []


def test_no_room_above_the_experiment_is_named_after_a_form_of_it() -> None:
    """Neither its modules, nor the tests of them, nor what stands in the modules."""
    folders = [ROOT / top / room for top in ("thermofit", "tests") for room in ABOVE]
    files = [p for folder in folders for p in folder.rglob("*.py")]
    form = re.compile(r"coupon|body|bodies", re.IGNORECASE)
    assert [name_of(p) for p in files if form.search(p.name)] == []
    named = []
    for path in (p for p in MODULES if p.relative_to(ROOT).parts[1] in ABOVE):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, Function | ast.ClassDef) and form.search(node.name):
                named.append(f"{name_of(path)}: {node.name}")
    assert named == []


def test_functions_have_return_types() -> None:
    untyped = [f"{name_of(path)}: {node.name}" for path in MODULES for node in functions(path) if node.returns is None]
    assert untyped == []


def test_modules_say_what_they_are_in_ascii() -> None:
    assert [name_of(path) for path in MODULES if not path.read_text(encoding="utf-8").isascii()] == []
    assert [name_of(path) for path in MODULES if not ast.get_docstring(ast.parse(path.read_text(encoding="utf-8")))] == []


def private_names(text: str) -> list[str]:
    """Private names of thermofit that a test imports, takes from a module, or replaces."""
    tree, modules, found = ast.parse(text), set(), []
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("thermofit"):
            found += [a.name for a in node.names if a.name.startswith("_") and not a.name.endswith("__")]
            modules |= {a.asname or a.name for a in node.names if a.name[:1].islower()}
        elif isinstance(node, ast.Import):
            modules |= {a.asname for a in node.names if a.name.startswith("thermofit") and a.asname}
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in modules:
            found += [node.attr] if node.attr.startswith("_") and not node.attr.endswith("__") else []
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "setattr":
            texts = [a.value for a in node.args[:2] if isinstance(a, ast.Constant) and isinstance(a.value, str)]
            found += [t for t in texts if t.rpartition(".")[2].startswith("_") and not t.endswith("__")]
    return found


def test_no_test_uses_a_private_name() -> None:
    used = {name_of(path): names for path in sorted((ROOT / "tests").rglob("*.py")) if (names := private_names(path.read_text()))}
    assert used == {}
    assert private_names("from thermofit.a import _b\nfrom thermofit import c\nc._d()\npatch.setattr(c, '_e', 1)") == ["_b", "_e", "_d"]
