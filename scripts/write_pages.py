"""The pages of docs/reference, from the program: every command, every key of the study, every parameter, effect and hardening law."""

from __future__ import annotations

import ast
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import typer.main
import yaml

from thermofit.cli.app import app
from thermofit.core.parameters import LAW, Param
from thermofit.effects.catalogue import AXIAL, BASE, HEAT, KINEMATICS, LOAD, MATERIAL, MEASUREMENT, Effect, effects
from thermofit.law.hardening.catalogue import hardening_laws
from thermofit.law.surface.catalogue import surfaces
from thermofit.study.study import json_schema

FOLDER = Path(__file__).resolve().parent.parent / "docs" / "reference"
MADE = "<!-- Written by `make schema` (scripts/write_pages.py): edit the program, not this page. -->"
SLOTS = {
    "Of the base law": BASE,
    "Of the material": MATERIAL,
    "Of the heat balance": (*HEAT, *AXIAL),
    "Of load and motion": (*LOAD, *KINEMATICS),
    "Of the instruments": MEASUREMENT,
}
Schema = Mapping[str, Any]


def pages() -> dict[str, str]:
    """Text of every generated page by file name."""
    return {
        "commands.md": commands_page(),
        "keys.md": keys_page(),
        "catalogue.md": catalogue_page(),
        "thresholds.md": thresholds_page(),
    }


def main() -> None:
    """Write the pages and say where."""
    FOLDER.mkdir(exist_ok=True)
    for name, text in pages().items():
        (FOLDER / name).write_text(text, encoding="utf-8")
        print(FOLDER / name)


def page(title: str, *parts: str) -> str:
    """A page of paragraphs."""
    return "\n\n".join([f"# {title}", MADE, *(part.strip("\n") for part in parts)]) + "\n"


def table(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table of Markdown."""
    lines = [f"| {' | '.join(columns)} |", "|" + " --- |" * len(columns)]
    return "\n".join(lines + [f"| {' | '.join(map(cell, row))} |" for row in rows])


def cell(text: str) -> str:
    """Text in one cell: on one line, bars escaped."""
    return " ".join(text.split()).replace("|", "\\|")


def plain(text: str) -> str:
    """Help without the markup of the terminal."""
    return re.sub(r"\[/?(bold|dim|italic)?\]", "", text).strip()


# Commands


def commands_page() -> str:
    """Every command with its arguments and options, grouped as `thermofit --help` does."""
    group = typer.main.get_command(app)
    panels: dict[str, list[tuple[str, Any]]] = {}
    for name, command in group.commands.items():  # type: ignore[attr-defined]
        panels.setdefault(str(command.rich_help_panel), []).append((name, command))
    parts = ["Each command prints this with `thermofit COMMAND --help`.", table(("command", "does"), _overview(panels))]
    for panel, found in panels.items():
        parts.append(f"## {panel}")
        parts += [_command(name, command) for name, command in found]
    return page("Commands", *parts)


def _overview(panels: Mapping[str, Sequence[tuple[str, Any]]]) -> list[tuple[str, str]]:
    return [(f"[`{name}`](#{name})", _first_line(command)) for found in panels.values() for name, command in found]


def _first_line(command: Any) -> str:
    return plain(command.help or "").split("\n")[0]


def _command(name: str, command: Any) -> str:
    """A command, or a group of them with what it holds."""
    if (inner := getattr(command, "commands", None)) is not None:
        return "\n\n".join([f"### {name}", *_paragraphs(command), *(_command(f"{name} {one}", found) for one, found in inner.items())])
    examples = [line.strip() for line in plain(command.epilog or "").splitlines()]
    examples = [re.sub(r"^Examples?: *", "", line) for line in examples]
    shown = "\n".join(f"    {line}" for line in examples if line)
    rows = [row for parameter in command.params if (row := _option(parameter)) is not None]
    return "\n\n".join([f"### {name}", *_paragraphs(command), *([shown] if shown else []), table(("option", "does", "default"), rows)])


def _paragraphs(command: Any) -> list[str]:
    return [" ".join(text.split()) for text in plain(command.help or "").split("\n\n")]


def _option(parameter: Any) -> tuple[str, str, str] | None:
    """One row of an argument or option; None for what every program has."""
    if parameter.name == "help" or getattr(parameter, "hidden", False):
        return None
    metavar = parameter.metavar or ""
    if parameter.param_type_name == "argument":
        return (f"`{metavar}`", plain(getattr(parameter, "help", "") or ""), "required" if parameter.required else "")
    names = ", ".join((*parameter.opts, *parameter.secondary_opts))
    default = "" if parameter.is_flag or parameter.default in (None, (), "") else f"`{parameter.default}`"
    return (f"`{names}{' ' + metavar if metavar and not parameter.is_flag else ''}`", plain(parameter.help or ""), default)


# Keys of the study


def keys_page() -> str:
    """Every key of the study file, section by section, from the schema that also checks the file."""
    schema = json_schema()
    kinds = schema["$defs"]
    parts = [
        "A study is one YAML file. `thermofit new study.yaml` writes one with comments. A key that is not known is an error, and the "
        "nearest known one is named. The same list for editors is [study.schema.json](../study.schema.json).",
        "Units are mm, N, s, K and MPa.",
        "## The study",
        _section(schema, kinds),
        *(f"## {name}\n\n{_section(kinds[name], kinds)}" for name in _in_order(schema, kinds)),
    ]
    return page("Keys of the study", *parts)


def _in_order(schema: Schema, kinds: Mapping[str, Schema]) -> list[str]:
    """Sections as they are met, from the top of the file down."""
    order: list[str] = []

    def visit(part: Any) -> None:
        for name in re.findall(r'"#/\$defs/(\w+)"', json.dumps(part)):
            if name not in order:
                order.append(name)
                visit(kinds[name].get("properties", {}))

    visit(schema["properties"])
    return order


def _section(section: Schema, kinds: Mapping[str, Schema]) -> str:
    needed = section.get("required", ())
    rows = [
        (f"`{key}`", _kind(value), "required" if key in needed else _default(value), _meaning(value, kinds))
        for key, value in section.get("properties", {}).items()
    ]
    said = " ".join(section.get("description", "").split())
    return "\n\n".join([*([said] if said else []), table(("key", "value", "default", "meaning"), rows)])


def _meaning(value: Schema, kinds: Mapping[str, Schema]) -> str:
    """What is said of a key, else of the section that it holds."""
    named = re.findall(r'"#/\$defs/(\w+)"', json.dumps(value))
    return str(value.get("description") or (kinds[named[0]].get("description", "") if len(named) == 1 else ""))


def _kind(value: Schema) -> str:
    """What a key may hold, in words."""
    if "$ref" in value:
        name = value["$ref"].rpartition("/")[2]
        return f"[{name}](#{name.lower()})"
    for union in ("anyOf", "oneOf"):
        if union in value:
            found = [_kind(one) for one in value[union] if one.get("type") != "null"]
            return "parameter name" if any(_names_parameters(one) for one in value[union]) else " or ".join(dict.fromkeys(found))
    if "enum" in value:
        return " or ".join(f"`{one}`" for one in value["enum"])
    if "const" in value:
        return f"`{value['const']}`"
    kind = value.get("type", "anything")
    if kind == "array":
        return _list(value)
    if kind == "object":
        inner = value.get("additionalProperties")
        return f"names with {_kind(inner)}" if isinstance(inner, dict) else "section"
    return {"number": "number", "integer": "whole number", "string": "text", "boolean": "`true` or `false`"}.get(kind, kind) + _range(value)


def _names_parameters(value: Schema) -> bool:
    return "alpha_exp" in value.get("enum", ())


def _list(value: Schema) -> str:
    if "prefixItems" in value:
        return "[" + ", ".join(_kind(one) for one in value["prefixItems"]) + "]"
    return f"list of {_kind(value['items'])}" if value.get("items") else "list"


def _range(value: Schema) -> str:
    signs = {"exclusiveMinimum": ">", "minimum": ">=", "exclusiveMaximum": "<", "maximum": "<="}
    return "".join(f" {sign} {value[key]:g}" for key, sign in signs.items() if key in value)


def _default(value: Schema) -> str:
    """The default as YAML; that of a section stands in the section."""
    if "default" not in value or (isinstance(value["default"], dict) and value["default"]):
        return ""
    return f"`{json.dumps(value['default'])}`".replace('"', "")


# Parameters, effects, hardening laws


def catalogue_page() -> str:
    """Parameters of the base law, every effect with formula and source, every hardening law and yield surface."""
    parts = [
        "What the model holds. At the neutral value of its first parameter an effect is exactly off. `thermofit diagnose` asks for each of "
        "them. [Your own](../effects.md) is one file.",
        "## Parameters of the base law",
        table(("name", "unit", "neutral", "physical bounds", "meaning"), map(_param, LAW)),
        "## Hardening laws",
        "Chosen by the key `hardening`; see [hardening laws](../hardening.md).",
        table(("name", "formula", "source"), ((f"`{law.name}`", _code(law.file.FORMULA), law.file.SOURCE) for law in hardening_laws())),
        "## Yield surfaces",
        "Chosen by the key `yield_surface`; see [yield surfaces](../yield-surfaces.md).",
        table(("name", "formula", "source"), ((f"`{one.name}`", _code(one.file.FORMULA), one.file.SOURCE) for one in surfaces())),
        "## Effects",
    ]
    for title, slots in SLOTS.items():
        parts += [f"### {title}", table(("effect", "slot", "formula", "parameters", "source"), map(_effect, effects(slots)))]
    return page("Parameters, effects, hardening laws", *parts)


def _param(param: Param) -> tuple[str, ...]:
    return (f"`{param.name}`", param.unit, f"{param.neutral:g}", f"{param.lower:g} to {param.upper:g}", param.meaning)


def _effect(effect: Effect) -> tuple[str, ...]:
    own = "<br>".join(f"`{param.name.rpartition('.')[2]}` ({param.unit}): {param.meaning}" for param in effect.params)
    return (f"`{effect.name}`", f"`{effect.slot}`", _code(effect.formula), own, effect.source)


def _code(text: str) -> str:
    return f"`{' '.join(text.split())}`"


# Thresholds

ROOM = Path(__file__).resolve().parent.parent / "thermofit" / "diagnose"
KINDS_OF_NUMBERS = {
    "decides": ("What decides", "Another value may give another answer."),
    "resolves": ("What resolves", "How finely something is looked at."),
    "ends": ("What ends", "How long something is looked for: they cost time, and a search that is cut short says so."),
}


def thresholds() -> dict[str, tuple[str, str]]:
    """Value and meaning of every number that stands by itself in a module of the diagnosis, by "module.NAME"; of several that one line
    holds, by the first. Numbers by which another module is meant alone (an alias) are not listed."""
    found: dict[str, tuple[str, str]] = {}
    for path in sorted(ROOM.glob("*.py")):
        body = ast.parse(path.read_text(encoding="utf-8")).body
        for node, after in zip(body, [*body[1:], None], strict=True):
            target = node.targets[0] if isinstance(node, ast.Assign) else node.target if isinstance(node, ast.AnnAssign) else None
            value = node.value if isinstance(node, ast.Assign | ast.AnnAssign) else None
            if target is None or value is None or not any(_is_number(part) for part in ast.walk(value)):
                continue
            names = [ast.unparse(one) for one in (target.elts if isinstance(target, ast.Tuple) else [target])]
            text = after.value if isinstance(after, ast.Expr) else None
            meaning = text.value if isinstance(text, ast.Constant) and isinstance(text.value, str) else ""
            found[f"{path.stem}.{names[0]}"] = (f"{', '.join(names)} = {_short(ast.unparse(value))}", meaning)
    return found


def _is_number(node: ast.AST) -> bool:
    return isinstance(node, ast.Constant) and isinstance(node.value, int | float) and not isinstance(node.value, bool)


def _short(text: str, most: int = 60) -> str:
    return text if len(text) <= most else f"{text[:most].rstrip()} ..."


def thresholds_page() -> str:
    """Every number of the diagnosis, its meaning and where it comes from. ValueError where one has no origin, or an origin no number."""
    origins = yaml.safe_load(Path(__file__).with_name("thresholds.yaml").read_text(encoding="utf-8"))
    numbers = thresholds()
    listed = [name for kind in KINDS_OF_NUMBERS for name in origins[kind]]
    if set(listed) != set(numbers) or len(listed) != len(set(listed)):
        odd = sorted(set(listed) ^ set(numbers)) or sorted({n for n in listed if listed.count(n) > 1})
        raise ValueError(f"scripts/thresholds.yaml: {', '.join(odd)} stand there or in thermofit/diagnose, expected once in both")
    parts = [
        f"Every number in `thermofit/diagnose` that stands by itself. {len(origins['decides'])} decide, {len(origins['resolves'])} say "
        f"how finely something is looked at, {len(origins['ends'])} how long. Origins are kept in `scripts/thresholds.yaml`."
    ]
    for kind, (title, words) in KINDS_OF_NUMBERS.items():
        rows = [(f"`{name}`", f"`{numbers[name][0]}`", numbers[name][1], origin) for name, origin in origins[kind].items()]
        parts += [f"## {title}", words, table(("number", "value", "meaning", "where it comes from"), rows)]
    return page("Thresholds of the diagnosis", *parts)


if __name__ == "__main__":
    main()
