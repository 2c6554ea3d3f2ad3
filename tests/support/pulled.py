"""A virtual coupon that is pulled, unloaded and pulled on, and the study on it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml
from record_studies import FIXED, record, write_record

CORNERS = [(0.0, 0.0), (50.0, 0.03), (58.0, 0.027), (75.0, 0.03), (80.0, 0.05)]
HEAT = ("beta", "tau", "lag")


def pulled_study(folder: Path, diagnosed: tuple[str, ...], records: tuple[dict[str, Any], ...] = (), **more: Any) -> Path:
    """A study on that coupon whose thermal stage is fitted and whose `diagnosed` parameters take part in the loop; `records` stand beside
    its own, and `more` holds further parameters."""
    write_record(folder / "pull.csv", CORNERS, 23.0, 1)
    tree = {
        "name": "pulled",
        "run_dir": str(folder / "run"),
        "model": 1,
        "coupon": {"records": [record("pull", 23.0), *records]},
        "parameters": {
            "E": {"start": 190e3, "bounds": [1e5, 3e5]},
            "M_y0": {"start": 300.0, "bounds": [50.0, 1000.0]},
            "M_yinf": {"start": 580.0, "bounds": [100.0, 2000.0]},
            "H_exp": {"start": 12.0, "bounds": [0.1, 100.0]},
            "beta": {"start": 0.8, "bounds": [0.0, 5.0]},
            "tau": {"start": 45.0, "bounds": [1.0, 1e5]},
            "lag": {"start": 0.6, "bounds": [0.0, 20.0]},
            **FIXED,
            **more,
        },
        "stages": {"thermal": {"free": list(HEAT), "channels": {"dtheta": {}}}},
        "diagnosis": {"max_effects": 1, "channels": ["dtheta"], "free": list(diagnosed)},
    }
    path = folder / "pulled.yaml"
    path.write_text(yaml.safe_dump(tree), encoding="utf-8")
    return path
