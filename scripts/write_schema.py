"""Write docs/study.schema.json, the JSON schema of the study file for editors."""

from __future__ import annotations

import json
from pathlib import Path

from thermofit.study.study import json_schema

PATH = Path(__file__).resolve().parent.parent / "docs" / "study.schema.json"


def main() -> None:
    """Write the schema and say where."""
    PATH.write_text(json.dumps(json_schema(), indent=2) + "\n", encoding="utf-8")
    print(PATH)


if __name__ == "__main__":
    main()
