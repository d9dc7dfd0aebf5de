"""Every reader of text at its size limit: processor time and memory of a process that reads one such file.

The files are made here: as many rows as fit below the limit, of numbers with all their digits, as programs
write them; and of the shortest rows, which make the most samples. A last kind is damaged in its last row.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.formats.text import LARGEST_TEXT_BYTES
from benchmarks.rows import row

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

READ_WITHIN_S = 2.0
MOST_MB = 1000.0
SPARE_BYTES = 65536
DAMAGE = "?"
CHILD = """
import json, sys, time
from pathlib import Path
from rig.errors import BadInput
from analysis import formats, samples
from analysis.formats import doubts, values
import analysis.recipes.steps, xarray
formats.recognise(Path(sys.argv[1]))
samples.make_samples([[0.0, 0.0, 1.0]], [[0.0, 0.0, 1.0]], [1.0])
begin = time.process_time()
try:
    rows = samples.read(sys.argv[1]).sizes["sample"]
except BadInput as error:
    rows = str(error)
seconds = time.process_time() - begin
# Not ru_maxrss: that remembers the process that started this one.
status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
print(json.dumps([rows, seconds, int(status["VmHWM"].split()[0]) / 1024]))
"""

Rows = dict[str, tuple[str, "Callable[[int, list[str]], str]"]]


def run(plots: Path | None) -> Iterator[dict[str, Any]]:
    """Measure; see the module."""
    del plots
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "file.dat"
        for name, text in _texts():
            path.write_text(text, encoding="utf-8")
            yield from _measured(name, path, text)


def _measured(name: str, path: Path, text: str) -> Iterator[dict[str, Any]]:
    rows, seconds, peak_mb = _read(path)
    what = f"{name}, {len(text) / 1e6:.1f} MB"
    yield row(f"{what}: samples", rows if isinstance(rows, int) else float("nan"), "", 1.0, at_least=True)
    yield row(f"{what}: processor time", seconds, "s", READ_WITHIN_S)
    yield row(f"{what}: most memory of the process", peak_mb, "MB", MOST_MB)
    digit = max(text.rfind(str(value)) for value in range(10))
    path.write_text(f"{text[:digit]}{DAMAGE}{text[digit + 1 :]}", encoding="utf-8")
    told, seconds, _ = _read(path)
    yield row(f"{what}, last number damaged: told", isinstance(told, str), "", 1.0, at_least=True)
    yield row(f"{what}, last number damaged: processor time", seconds, "s", READ_WITHIN_S)


def _read(path: Path) -> tuple[int | str, float, float]:
    """Return the number of samples or the complaint, seconds, and MB."""
    done = subprocess.run(
        [sys.executable, "-c", CHILD, str(path)], capture_output=True, text=True, check=True
    )
    rows, seconds, peak_mb = json.loads(done.stdout)
    return rows, seconds, peak_mb


def _texts() -> Iterator[tuple[str, str]]:
    """Give a name and a text for each kind."""
    for name, (head, line) in _rows().items():
        yield name, _filled(head, line)
    yield "zemax", _zemax()
    yield "klems", _klems()
    yield "rt300s_text", _jdv()
    yield "ssdd", _ssdd()


def _rows() -> Rows:
    """Give the head of each format of one sample a row, and what makes a row of its number and digits."""
    return {
        "csv": ("theta_i_deg,phi_i_deg,theta_o_deg,phi_o_deg,f_r,u_f_r\n", lambda _, n: ",".join(n)),
        "astm": ("VARS theta_i,phi_i,theta_s,phi_s,500nm\n", lambda _, n: ",".join(n[:5])),
        "astm, short rows": (
            "VARS theta_i,phi_i,theta_s,phi_s,500nm\n",
            lambda i, _: f"{i % 2},{i % 9},1,{i % 7},{i % 8}",
        ),
        "cornell": ("2\n500 600\n", lambda _, n: " ".join(n)),
        "cornell, short rows": ("1\n500\n", lambda i, _: f"{i % 2} {i % 9} 1 {i % 7} {i % 8}"),
        "alta": (
            "#DIM 4 1\n#PARAM_IN SPHERICAL_TL_PL_TV_PV\n#PARAM_OUT INV_STERADIAN\n",
            lambda _, n: " ".join(n[:5]),
        ),
        "fred": (
            "type bsdf_data\nformat angles=deg bsdf=value scale=1\n10 0\n",
            lambda i, n: f"{n[0]}\t{i / 1000}\t{n[2]}",
        ),
        "pab": ("#format: theta phi BSDF\n#intheta 10\n#inphi 0\n", lambda _, n: " ".join(n[:3])),
        "inplane": (
            "material,theta_o_deg,theta_i_deg,f_r\n",
            lambda _, n: f"paint,{n[0]},{n[1]},{n[2]}",
        ),
        "inplane, bands": (
            "theta_o_deg,theta_i_deg,wavelength_nm,f_r\n",
            lambda i, n: f"{i // 4 % 900 / 10},{i // 3600 / 100},{400 + i % 4},{n[0]}",
        ),
        "inplane, blanks": ("# phi_i theta_i phi_o theta_o brdf\n", lambda _, n: " ".join(n[:5])),
    }


def _filled(head: str, line: Callable[[int, list[str]], str]) -> str:
    """Repeat a row with other numbers until the limit is near; the number of rows divides by 4."""
    digits = np.random.default_rng(1).uniform(0.1, 1.5, 30_011).tolist()
    words = [repr(value) for value in digits]
    parts, size = [head], len(head)
    for i in count():
        start = 7 * i % (len(words) - 6)
        text = line(i, words[start : start + 6]) + "\n"
        if i % 4 == 0 and size > LARGEST_TEXT_BYTES - SPARE_BYTES:
            break
        parts.append(text)
        size += len(text)
    return "".join(parts)


def _cells(number: int) -> list[str]:
    return [f"{value:.6f}" for value in np.random.default_rng(2).uniform(0.1, 1.0, number)]


def _table(rows: int, columns: int, separator: str) -> str:
    cells = _cells(rows * columns)
    return "".join(f"{separator.join(cells[i * columns : (i + 1) * columns])}\n" for i in range(rows))


def _zemax() -> str:
    azimuths, radials = 1_000, 1_800
    lists = (("AngleOfIncidence", [30.0]), ("ScatterAzimuth", np.linspace(0.0, 180.0, azimuths)))
    head = "Source\tMeasured\nSymmetry\tPlaneSymmetrical\nSpectralContent\tMonochrome\nScatterType\tBRDF\n"
    for name, angles in (*lists, ("ScatterRadial", np.linspace(0.0, 120.0, radials))):
        head += f"{name}\t{len(angles)}\n" + "\t".join(f"{angle:.9g}" for angle in angles) + "\n"
    return f"{head}\nMonochrome\nDataBegin\nTIS\t0.1\n{_table(azimuths, radials, chr(9))}DataEnd\n"


def _klems() -> str:
    patches = 1_280
    basis = f"<AngleBasisBlock><Theta>40</Theta><nPhis>{patches}</nPhis></AngleBasisBlock>"
    return (
        "<WindowElement><Optical><Layer><DataDefinition>"
        "<IncidentDataStructure>Columns</IncidentDataStructure>"
        f"<AngleBasis><AngleBasisName>Own</AngleBasisName>{basis}</AngleBasis></DataDefinition>"
        "<WavelengthData><Wavelength>Visible</Wavelength><WavelengthDataBlock>"
        "<WavelengthDataDirection>Reflection Front</WavelengthDataDirection>"
        "<ColumnAngleBasis>Own</ColumnAngleBasis><RowAngleBasis>Own</RowAngleBasis><ScatteringData>\n"
        f"{_table(patches, patches, ' ')}"
        "</ScatteringData></WavelengthDataBlock></WavelengthData></Layer></Optical></WindowElement>\n"
    )


def _jdv() -> str:
    angles = range(-80, 81, 2)
    receive = "\t".join(map(str, angles))
    blocks, size = [], 0
    for i in count():
        cells = _table(len(angles), len(angles), "\t").splitlines()
        body = "".join(f"{angle}\t{cells[row]}\n" for row, angle in enumerate(angles))
        blocks.append(
            f"DataType:\tBRDF(RT-300S)\t \t\nSampleID:\tS\t\nIncidence:\t{i / 10}\t \t\n"
            "Polar:\t-80,80,2\t \t\n"
            f"Azimuth:\t-80,80,2\t \t\n\t\t\t\nRaw data\t\t\t\n\t{receive}\n{body}\t\t\t\n"
        )
        size += len(blocks[-1])
        if size + len(blocks[-1]) > LARGEST_TEXT_BYTES - SPARE_BYTES:
            return "".join(blocks)
    raise AssertionError


def _ssdd() -> str:
    lists = [np.arange(0.0, 90.0, 6.0), np.arange(0.0, 90.0, 0.5), np.arange(0.0, 360.0, 2.0)]
    words = [" ".join(f"{angle:g}" for angle in angles) for angles in lists]
    cells = int(np.prod([len(angles) for angles in lists]))
    return (
        "VERSION 0.2\nDATA_TYPE brdf\nCOLOR_MODEL rgb\nPARAM_TYPE spherical_coordinate_system\n"
        f"PARAM0_LIST {words[0]}\nPARAM2_LIST {words[1]}\nPARAM3_LIST {words[2]}\nDATA ascii\n"
        f"{_table(cells, 3, ' ')}"
    )
