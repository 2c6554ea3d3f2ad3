"""Small coupon records in the layouts of testing machines, as bytes."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Sequence

import numpy as np
import openpyxl
import scipy.io

ROWS = 12


def rows(n: int = ROWS) -> list[list[float]]:
    """Time s, force, extension mm, crosshead mm."""
    return [[0.5 * k, 1.5 * k, 0.01 * k, 0.02 * k] for k in range(n)]


def _lines(table: Sequence[Sequence[object]], separator: str) -> str:
    return "".join(separator.join(str(cell) for cell in row) + "\n" for row in table)


PLAIN = ("C_1_Temps[s],C_1_Force[kN],ext[mm],ext[mm]\n" + _lines(rows(), ",")).encode()
INSTRON = (
    "Time;Crosshead separation;Load;Extensometer elongation\n(sec);(mm);(kN);(%)\n"
    + "".join(f"{t:.2f};{x:.3f};{f:.3f};{100 * e:.3f}\n".replace(".", ",") for t, f, e, x in rows(8))
    + "".join(f"{t:.2f};{x:.3f};{f:.3f};\n".replace(".", ",") for t, f, _, x in rows()[8:])
).encode()
SCHENCK = (
    "Zeit  1 - Standardmessrate [s]\tKraft [N]\tWegaufnehmer [mm]\tPyrometer [\u00b0C]\tDrehwinkel [V]\n"
    + "".join(f"{t}\t{f}\t{e}\t{20 + k / 10}\t-1000000\t\n" for k, (t, f, e, _) in enumerate(rows()))
).encode("latin-1")
COMMENTED = ("#time, displacement\n" + _lines([row[:2] for row in rows()], ",")).encode()
BARE = ("% by hand\n" + _lines([row[1:3] for row in rows(14)], " ")).encode()
STATED = (
    "# Temperature: 293 K\n# strain rate = 1e-3 1/s, true stress\nstrain,stress [MPa]\n" + _lines([row[1:3] for row in rows()], ",")
).encode()
RESULTS = ("Specimen;Rm;A\n;MPa;%\nS1;512;23\n\nTime;Force;Strain\ns;kN;%\n" + _lines([row[:3] for row in rows()], ";")).encode()
DATED = (
    "stamp;force [N];specimen\n" + "".join(f"2018-12-11 23:59:{50 + k / 2:05.2f};{f};A {k // 6}\n" for k, (_, f, _, _) in enumerate(rows()))
).encode()
PLACED = (
    "".join(f"{name:>12}" for name in ("Time", "Force (Def.)", "Strain (D)"))
    + "\n"
    + "".join("".join(f"{x:12.4f}" for x in row[:3]) + "\n" for row in rows())
).encode()
SANDIA = (
    "{'temperature':534.67, 'engineering_strain_rate':0.0001, 'direction':'R11' }\n"
    "time, load, engineering_strain, engineering_stress\n" + _lines(rows(), ",")
).encode()
TESTXPERT = (
    '"Specimen thickness",1.5,"mm"\n"Specimen width",4.89,"mm"\n"Cross-section",7.335,"mm\u00b2"\n"Gage length, standard travel",30,"mm"\n'
    '"Extensometer",""\n"Operator",""\n"v1",1,"mm/min"\n"Time","Standard force","Strain","Capteur de course"\n"s","N","mm","mm"\n'
    + _lines(rows(), ",")
).encode("latin-1")
TESTXPERT_TABS = (
    '"aktuelle Probe"\t"12"\n"Probenbreite b0"\t11.8\t"mm"\n"Probendicke a0"\t0.19\t"mm"\n"Pr\u00fcfgeschwindigkeit"\t150\t"mm/min"\n'
    '"Pr\u00fcfzeit"\t"Standardkraft"\t"Dehnung"\t"Traverse abs."\n"s"\t"N"\t"%"\t"mm"\n' + _lines(rows(), "\t")
).encode("latin-1")


def workbook(sheets: dict[str, Sequence[Sequence[object]]], padded_to: int = 0) -> bytes:
    """Workbook of sheets; the first one padded with rows of formatted empty cells up to row `padded_to`."""
    book = openpyxl.Workbook()
    book.remove(book.active)
    for name, table in sheets.items():
        sheet = book.create_sheet(name)
        for row in table:
            sheet.append(list(row))
        if padded_to and sheet is book.worksheets[0]:
            for k in range(len(table) + 1, padded_to + 1):
                sheet.cell(k, 1).number_format = "0.00"
    file = io.BytesIO()
    book.save(file)
    return file.getvalue()


MACHINE_ROWS: list[list[object]] = [
    ["L0", 8, "mm", None, "D", 5.98, "mm", None, "F", 1.5, "kN"],
    [None, None, None, None, "A", 28.086, "mm2"],
    [],
    ["S/No", "System Date", "C_1_Temps[s]", "C_1_Force[kN]", "C_1_Angle[mm]", "e_true"],
    *[[k, "11.12.18 14:50", t, f, e, e / 8] for k, (t, f, e, _) in enumerate(rows(), start=1)],
]
MACHINE = workbook({"Sheet1": MACHINE_ROWS}, padded_to=60)


def catman_rows(slow: bool) -> list[list[object]]:
    """One time column, or a slower second one that belongs to the load."""
    names = ["Time  1 - default sample rate   ", "Extenso  ", "Temperature  "]
    units = ["s    ", "mm   ", "\u00b0C   "]
    rate = ["50.00 ms (20 Hz)"] * 3
    data: list[list[object]] = [[t, e, 23.0 + 0.1 * k] for k, (t, _, e, _) in enumerate(rows())]
    if slow:
        names, units, rate = [*names, "Time  1 - slow sample rate", "Load"], [*units, "s", "kN"], [*rate, *["100.00 ms (10 Hz)"] * 2]
        for k, (t, f, _, _) in enumerate(rows()[: ROWS // 2]):
            data[k] += [2.0 * t, f]
    settings = [["Sensor: Pt100"] * len(names)] * 8
    return [["File comment: "], names, units, ["11.12.18 14:50:30"] * len(names), rate, *settings, *data]


CATMAN = workbook({"Sheet1": catman_rows(False)})
CATMAN_TWO_RATES = workbook({"Sheet1": catman_rows(True)})


def testxpert_sheets(names: Sequence[str]) -> dict[str, Sequence[Sequence[object]]]:
    """Sheets of a testXpert workbook with these specimens."""
    results = [["Date/Clock time", "Specimen designation", "a0", "b0"], ["", "", "mm", "mm"]]
    sheets: dict[str, Sequence[Sequence[object]]] = {"Parameters": [["Test standard"]]}
    sheets["Results"] = [*results, *[[45251.6, name, 1.3 + k, 6.0] for k, name in enumerate(names)]]
    for name in names:
        head: list[list[object]] = [[name] * 4, ["Test time", "Standard force", "Strain", "Standard travel"], ["s", "N", "mm", "mm"]]
        sheets[f"Values {name}"] = [*head, *rows()]
    return sheets


TESTXPERT_BOOK = workbook(testxpert_sheets(["DPLA"]))
TESTXPERT_BOOKS = workbook(testxpert_sheets(["A", "B"]))


def matlab(variables: dict[str, object], compressed: bool = False) -> bytes:
    """MATLAB 5 file."""
    file = io.BytesIO()
    scipy.io.savemat(file, variables, do_compression=compressed)
    return file.getvalue()


def matlab_tests(tags: Sequence[str] = ("GL_A", "GL_B")) -> dict[str, object]:
    """Cell array `data` with one struct per tag; the second one has F0."""
    table = np.array(rows())
    cells = np.empty((len(tags), 1), dtype=object)
    for k, tag in enumerate(tags):
        cells[k, 0] = {"t": table[:, :1], "F": table[:, 1:2], "dL": table[:, 2:3], "tag": tag, "w0": 6.0, "t0": 1.3, "A0": 7.8, "L0": 40.0}
        cells[k, 0] |= {"T": 100.0, "F0": -3.0 if k else 0.0}
    return {"data": cells}


MATLAB_CELLS = matlab(matlab_tests())
MATLAB_PACKED = matlab(matlab_tests(), compressed=True)
MATLAB_FLAT = matlab(
    {name: np.array(rows())[:, [k]] for k, name in enumerate(("t", "F", "u", "utr"))} | {"A0": 8.34, "L0": 25.0, "Af": 2.3}
)


def remade(archive: bytes, change: object) -> bytes:
    """A workbook whose sheets went through `change` (bytes to bytes), zipped again."""
    assert callable(change)
    file = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(archive)) as old, zipfile.ZipFile(file, "w") as new:
        for name in old.namelist():
            content = old.read(name)
            inner = name.startswith("xl/worksheets/sheet") or name in ("xl/workbook.xml", "xl/sharedStrings.xml")
            new.writestr(name, change(content.replace(b"><", b">\n<")) if inner else content)
    return file.getvalue()
