"""What a human reads of `data list`, `data fetch` and `inspect`; printed from their JSON."""

from __future__ import annotations

from rich.console import Console

from thermofit.cli.numbers import number
from thermofit.cli.printing import Result, make_console, print_pairs, print_remarks, print_verdict, table


def listing(result: Result) -> None:
    """One row for each set, then what each is good for and how to cite it."""
    out = make_console()
    rows = [[s["name"], ", ".join(s["licences"]), s["present"], str(s["files"]), _size(s["bytes"])] for s in result["sets"]]
    out.print(table("", ("set", "licence", "present", "files", "size"), rows, 3))
    for entry in result["sets"]:
        out.print(f"{entry['name']}: {entry['title']}", style="bold")
        out.print(f"  use     {entry['use']}", soft_wrap=True)
        origins = ", ".join(f"{o['project']} at {o['commit'][:7]}" for o in entry["origins"])
        out.print(f"  origin  {origins}", soft_wrap=True)
        out.print(f"  cite    {entry['citation']}", soft_wrap=True)
        print_remarks(out, [f"{path} is derived, only in a local mirror" for path in entry["local_only"]])
    print_verdict(out, result)


def fetched(result: Result) -> None:
    """Where each set lies, and how THERMOFIT_DATA is to be set."""
    out = make_console()
    for entry in result["sets"]:
        counts = ", ".join(f"{n} {_HOW[how]}" for how, n in entry["counts"].items() if n)
        out.print(f"{entry['name']}: {counts}", style="bold")
        for folder in entry["folders"]:
            out.print(f"  in    {folder}", soft_wrap=True)
        out.print(f"  cite  {entry['citation']}", soft_wrap=True)
        print_remarks(out, entry["remarks"])
    print_verdict(out, result)


_HOW = {"mirror": "from the mirror", "there": "there already", "downloaded": "downloaded", "not public": "not public"}


def inspected(result: Result) -> None:
    """Everything about a file, or one line for each group of files of a folder."""
    out = make_console()
    out.print(f"{result['path']}  {result['what']}", style="bold", soft_wrap=True)
    if "groups" in result:
        rows = [[g["files"], g["format"], str(g["count"]), g["summary"]] for g in result["groups"]]
        out.print(table("", ("files", "format", "count", "what they hold"), rows, 4))
    print_pairs(out, "", {**result.get("written", {}), **result.get("header", {})})
    for part in result.get("parts", ()):
        _part(out, part)
    print_remarks(out, result["remarks"])
    if result["suggestion"]:
        out.print("lines to start from:", style="bold")
        out.print(result["suggestion"], soft_wrap=True)
    print_verdict(out, result)


def _part(out: Console, part: Result) -> None:
    """A file, or one test of it."""
    print_pairs(out, part["name"], {key: number(value) if isinstance(value, float) else str(value) for key, value in part["facts"].items()})
    if part["columns"]:
        unread = [column["name"] for column in part["columns"] if column["missing"] is None and not column["meaning"]]
        columns = ("column", "meaning", "unit", "unit from", "range", "missing", "noise")
        out.print(table("", columns, (_column_row(column) for column in part["columns"] if column["name"] not in unread), 4))
        if unread:
            out.print(f"not used: {', '.join(unread)}", soft_wrap=True)


def _column_row(column: Result) -> list[str]:
    span = "" if column["low"] is None else f"{number(column['low'], 5)} .. {number(column['high'], 5)} {column['fixed_unit']}".rstrip()
    missing = "" if column["missing"] is None else str(column["missing"])
    noise = "" if column["noise"] is None else f"{number(column['noise'], 3)} {column['fixed_unit']}".rstrip()
    source = column["unit_from"] if column["unit"] or span else ""
    return [column["name"], column["meaning"], column["unit"], source, span, missing, noise]


def _size(n: int) -> str:
    return f"{n / 1e6:.1f} MB" if n >= 1e5 else f"{n / 1e3:.1f} kB"
