"""The folder that configs/others-*.yaml read, made from clones of the public projects of docs/coupons-of-others.md.

    python scripts/coupons_of_others.py CLONES OUT

CLONES holds git repositories (with or without a work tree) named OWNER+NAME; every file is taken from the commit below. Files that no
reader takes are rewritten as tables with names and units under OUT/SET/converted; no value is changed. Where a record has no clock the
time is built as its comment says.
"""

from __future__ import annotations

import argparse
import re
import subprocess
from pathlib import Path

import numpy as np

SETS: dict[str, tuple[str, str, tuple[str, ...]]] = {
    "42crmos4": (
        "materialdigital+demodata_tensiletest_42CrMoS4",
        "ffb58b4b9553ccf59c807f23d86eda7c9fd97cf3",
        tuple(f"original_data/46NT{n}.csv" for n in ("71", "83", "9B", "AB", "B1", "CB")),
    ),
    "steel1045n": (
        "DuncanWilliamGibbons+tensile-analyzer",
        "a5c59ddcb956179d9564bc4a2b43e18669894839",
        tuple(f"Test Data/Steel_1045_Normalized_{n}_Formatted.csv" for n in (1, 2, 3)),
    ),
    "steel1045-4130": (
        "lucasguesserts+mechanical_testing",
        "92ccdc810ba01a1722f21f49654b6aacc179c863",
        ("test/data/tensile/tensile_steel_1045.csv",),
    ),
    "bst-hot": ("Institute-of-Metal-Forming+notebooks-flow-stress", "f892c4581dca1662b0467e43429e85392407a30d", ("bst.csv",)),
    "al6082-hot": (
        "LightForm-group+dilatometer_modelling_and_constitutive_behaviour",
        "8685fe4067b443726d6e75ee73f35dd6bdc3715d",
        tuple(
            f"experimental_data/deformation/{rate}/{T}/{n}_Compression_Daniel_Al_Hom1_SHT_540C_Deform_{T}C_{word}s-1_QuenchHeGas__1.asc"
            for rate, word, T, n in (
                ("0.1", "0.1", 520, "006"),
                ("0.1", "0.1", 490, "007"),
                ("1", "1.0", 490, "008"),
                ("1", "1.0", 520, "018"),
            )
        ),
    ),
    "ss-cyclic": (
        "RunxinH+LM_Chaboche",
        "233d3bfd6db61d82f75424f2eeaad9ce48d3608f",
        ("sample_data/sample_data_1-3c.csv", "sample_data/sample_data_2_1-3c.csv"),
    ),
    "steel-cyclic-coarse": (
        "NHERI-SimCenter+quoFEM",
        "d4d750297f4635a3b3b4b51fbd3160d10c53eb86",
        ("Examples/qfem-0018/src/stress.1.coords", "Examples/qfem-0018/src/calDataField.csv"),
    ),
    "alloy617": (
        "janzenchoi+phd_code",
        "06413a48e25a6ec8cf8144d2f6bd83db6ac1751e",
        tuple(f"moga_neml/scripts/data/tensile/ansto/AirBase_1E-{n}_{bar}.csv" for n in (2, 3, 4) for bar in "AB")
        + tuple(
            f"moga_neml/scripts/data/tensile/inl/AirBase_{n}.csv"
            for n in ("1000_D12", "20_D5", "650_D8", "700_D4", "750_D6", "800_D7", "850_D9", "900_D10", "950_D11")
        ),
    ),
    "ti64-etmt": (
        "LightForm-group+xrdfit-two-phase-hot-deformation-analysis",
        "f256f3e031952bcd04aebb09f5266c0765481a18",
        ("example_data/ETMT_data/065_ETMT.txt",),
    ),
    "dc04": (
        "barabule+StressStrain",
        "3e7c2426e0e59960d0048fd6da66576b7363e187",
        ("assets/DC04_QS.csv", "assets/DC04_523s-1.csv", "assets/DC04_1067s-1.csv"),
    ),
    "az41d": ("barabule+StressStrain", "3e7c2426e0e59960d0048fd6da66576b7363e187", ("assets/az41d_sr1e-3s-1.csv",)),
    "al6061-ogawa": (
        "bbanerjee+HighRateExptData",
        "e93687602752786f402fb696d140245806763b92",
        tuple(f"6061T6AlData/ExptData/AlSigEpsOgawa{r}s{T}K.dat" for r in ("000057", "1500") for T in (77, 201, 289, 373, 473)),
    ),
    "q690": (
        "tjhequn+cyclic_plasticity_of_hss_Q690",
        "837309b0a9f567737069a1a142b60cf6f137db27",
        ("material_parameters_calibration/test_data/MTS_01.mat",),
    ),
    "porous-ti": (
        "Green-zy+A-Generalized-Constitutive-Model-for-Porous-Titanium-Alloy",
        "f66310f5a3d6026c1b2261251811756febb133fb",
        ("data.csv",),
    ),
    "shpb-iith": (
        "snkhaderi+IITH_split_hopkinson_bar_data_processing",
        "79f14bc849d461d4a1f98e15c1a2cbd6c5ea595a",
        ("sample_data.dat.out",),
    ),
    "st-shibanuma": (
        "Shibanuma-Lab+Parameters-Identification-for-Ductile-Fracture-Model",
        "82978110d7e1bf36a67cd9249d0960a8c9078e64",
        ("sample/ST_ss0.csv",),
    ),
}
"""Folder: project, commit, files."""


def content(clones: Path, project: str, commit: str, path: str) -> bytes:
    """A file of a project at a commit."""
    here = next(
        (p for p in (clones / project / "repo" / ".git", clones / project / "repo", clones / project) if (p / "HEAD").exists()), None
    )
    folder = here or clones / project / ".git"
    return subprocess.run(["git", f"--git-dir={folder}", "show", f"{commit}:{path}"], check=True, capture_output=True).stdout


def numbers(data: bytes, columns: tuple[int, ...], separator: str | None = ",") -> np.ndarray:
    """Rows (n, len(columns)) of a table whose cells of these columns are numbers; other rows (names, units) are passed over."""
    rows = []
    for line in data.decode("utf-8-sig", errors="replace").splitlines():
        cells = line.split(separator)
        try:
            rows.append([float(cells[k]) for k in columns])
        except (ValueError, IndexError):
            continue
    return np.array(rows)


def write(path: Path, **columns: np.ndarray) -> None:
    """Table with one row of names; a name ends in its unit behind two underscores (`1` none)."""
    units = {"1": "1", "MPa": "MPa", "s": "s", "pct": "%", "K": "K", "degC": "degC", "N": "N", "rate": "1/s"}
    path.parent.mkdir(parents=True, exist_ok=True)
    names = [name.rsplit("__", 1) for name in columns]
    lines = [",".join(f"{name.replace('_of_', ' ')} ({units[unit]})" for name, unit in names)]
    lines += [",".join(f"{x:.9g}" for x in row) for row in zip(*columns.values(), strict=True)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def convert(out: Path) -> None:
    """Tables of what no reader takes: a clock from a column of rates, a record in two files, a cut at the end of the deformation."""
    for path in (out / "al6082-hot").glob("*.asc"):  # names with blanks in them; No., Time, Tem.1, DL, Force, Strain, kf, Phi, ...
        rows = numbers(path.read_bytes(), tuple(range(13)), None)
        rows = rows[: int(np.argmax(rows[:, 7])) + 1]  # the deformation ends at the largest Phi
        found = re.search(r"Deform_(\d+C)_([\d.]+)s", path.name)
        assert found is not None
        write(
            out / f"al6082-hot/converted/{found[1]}-{found[2]}.csv",
            time__s=rows[:, 1],
            temperature__degC=rows[:, 2],
            force__N=rows[:, 4],
            true_stress__MPa=rows[:, 6],
            true_strain__1=rows[:, 7],
        )
    rows = numbers((out / "shpb-iith/sample_data.dat.out").read_bytes(), (0, 1, 2, 3))
    rows = rows[: int(np.argmax(rows[:, 0]))]  # up to the unloading; the clock is that of the column of the rate, 20 1/s at least
    steps = np.abs(np.diff(rows[:, 0])) / np.maximum(0.5 * (rows[1:, 3] + rows[:-1, 3]), 20.0)
    time = np.concatenate([[0.0], np.cumsum(np.maximum(steps, 1e-9))])
    write(
        out / "shpb-iith/converted/shpb.csv",
        time__s=time,
        strain__1=rows[:, 0],
        stress_of_out__MPa=rows[:, 1],
        stress_of_in__MPa=rows[:, 2],
        rate__rate=rows[:, 3],
    )
    strain = np.loadtxt(out / "steel-cyclic-coarse/stress.1.coords")
    first = (out / "steel-cyclic-coarse/calDataField.csv").read_text(encoding="utf-8").splitlines()[0]
    stress = np.array([float(cell) for cell in first.split(",") if cell.strip()])[: len(strain)]
    time = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(strain)))]) / 1e-3  # no clock: the path of the strain at 1e-3 1/s
    write(out / "steel-cyclic-coarse/converted/cyc.csv", time__s=time, strain__1=strain, stress__MPa=stress)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clones", type=Path)
    parser.add_argument("out", type=Path)
    chosen = parser.parse_args()
    for name, (project, commit, paths) in SETS.items():
        folder = chosen.out / name
        folder.mkdir(parents=True, exist_ok=True)
        for path in paths:
            (folder / Path(path).name).write_bytes(content(chosen.clones, project, commit, path))
    convert(chosen.out)


if __name__ == "__main__":
    main()
