"""Write the JSON schemas of the study file (docs/study.schema.json, for editors) and of report.json (docs/report.schema.json), and the
pages of docs/reference."""

from __future__ import annotations

import json
from pathlib import Path

import write_pages

from thermofit.report.html.content import report_schema
from thermofit.study.study import json_schema

DOCS = Path(__file__).resolve().parent.parent / "docs"
PATH = DOCS / "study.schema.json"
REPORT = DOCS / "report.schema.json"


def main() -> None:
    """Write the schemas and the pages, and say where."""
    for path, schema in ((PATH, json_schema()), (REPORT, report_schema())):
        path.write_text(json.dumps(schema, indent=2) + "\n", encoding="utf-8")
        print(path)
    write_pages.main()


if __name__ == "__main__":
    main()
