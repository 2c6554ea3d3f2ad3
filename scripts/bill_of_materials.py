"""What thermofit is made of: every package that it needs to run, with version and licence, as a CycloneDX 1.5 bill of materials.

Walks the requirements of the installed distribution, without extras, in the environment that runs this. `--page` prints docs/licences.md,
else it is the JSON of docs/sbom.json.
"""

from __future__ import annotations

import argparse
import json
import re
from importlib import metadata

from packaging.requirements import Requirement

ROOT = "thermofit"
HEAD = """# Licences

thermofit itself is under MIT. What it needs to run, with the versions of the environment in which `make licences` wrote this page and
licences as the packages state them; as a bill of materials (CycloneDX 1.5): [sbom.json](sbom.json).
"""


def licence_of(found: metadata.Distribution) -> str:
    """SPDX expression where the package states one, else its classifiers, else the first line of its licence field."""
    about = found.metadata
    if about.get("License-Expression"):
        return str(about["License-Expression"])
    classes = [c.split(" :: ")[-1] for c in about.get_all("Classifier") or () if c.startswith("License :: ")]
    if classes:
        return ", ".join(sorted(set(classes)))
    return (str(about.get("License") or "not stated").splitlines() or ["not stated"])[0][:60]


def needed(name: str, seen: dict[str, metadata.Distribution]) -> dict[str, metadata.Distribution]:
    """All distributions that one needs, by normalised name."""
    key = re.sub(r"[-_.]+", "-", name).lower()
    if key in seen:
        return seen
    seen[key] = found = metadata.distribution(name)
    for text in found.requires or ():
        wanted = Requirement(text)
        if wanted.marker is None or wanted.marker.evaluate({"extra": ""}):
            needed(wanted.name, seen)
    return seen


def main() -> None:
    """Print it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--page", action="store_true")
    options = parser.parse_args()
    found = {key: one for key, one in sorted(needed(ROOT, {}).items()) if key != ROOT}
    if options.page:
        print(HEAD)
        print("| package | version | licence |\n|---|---|---|")
        for key, one in found.items():
            print(f"| {key} | {one.version} | {licence_of(one)} |")
        return
    parts = [
        {
            "type": "library",
            "name": key,
            "version": one.version,
            "purl": f"pkg:pypi/{key}@{one.version}",
            "licenses": [{"license": {"name": licence_of(one)}}],
        }
        for key, one in found.items()
    ]
    about = {"component": {"type": "application", "name": ROOT, "version": metadata.version(ROOT)}}
    print(json.dumps({"bomFormat": "CycloneDX", "specVersion": "1.5", "version": 1, "metadata": about, "components": parts}, indent=1))


if __name__ == "__main__":
    main()
