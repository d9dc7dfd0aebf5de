"""One small whole file of every format that gonio reads, each made by a writer or written here by hand."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from analysis.formats.tensor import write_tensors
from analysis.samples import make_samples, write
from rig.angles import spherical_to_direction

if TYPE_CHECKING:
    from pathlib import Path

    import xarray as xr

CORNELL = "# paint\n2\n# wls\n500 600\n\n" + "".join(
    f"0.{i} 0.0 0.6 1.{j} 0.25{i} 0.5{j}\n" for i in range(1, 5) for j in range(4)
)
ALTA = "#DIM 4 1\n#PARAM_IN  SPHERICAL_TL_PL_TV_PV\n#PARAM_OUT INV_STERADIAN\n" + "".join(
    f"0.{i} 0 0.{j} 3.{i} 0.25{j}\n" for i in range(1, 5) for j in range(1, 5)
)
FRED = "type bsdf_data\nformat angles=deg bsdf=value scale=1\n" + "".join(
    f"{i}\t0\n" + "".join(f"{j}\t{p}\t0.0{i}{j}\n" for j in (5, 10, 20) for p in (0, 90, 180))
    for i in (10, 20, 30)
)
RADIANCE = "material,theta_o_deg,theta_i_deg,radiance_L_o\n" + "".join(
    f"Kupfer,{o},{i},0.0{o}{i}\n" for o in (15, 30, 45) for i in (10, 20, 40, 60)
)
CHASSIS = (
    "# (phi_i, theta_i) are the zenith and azimuth angles\n# at a wavelength lambda = 532 nm\n"
    "# phi_i theta_i phi_o theta_o brdf\n"
) + "".join(f"{i}. 0. {o}. 180. 0.1{i}{o + 90}\n" for i in (5, 30, 60) for o in (-60, -20, 20, 60))
ZEMAX = (
    "# a comment\nSource\tMeasured\nSymmetry\tPlaneSymmetrical\nSpectralContent\tMonochrome\n"
    "ScatterType\tBRDF\nSampleRotation\t1\n0\nAngleOfIncidence\t2\n10\t40\nScatterAzimuth\t3\n0\t90\t180\n"
    "ScatterRadial\t4\n0\t5\t20\t40\n\nMonochrome\nDataBegin\n"
    + "".join(
        f"TIS\t0.{b}\n" + "".join(f"0.1\t0.2{a}\t0.3{b}\t0.4{a}{b}\n" for a in (1, 2, 3)) for b in (1, 2)
    )
    + "DataEnd\n"
)
SSDD_BINARY = (
    b"VERSION 0.2\nDATA_TYPE brdf\nCOLOR_MODEL rgb\nPARAM_TYPE spherical_coordinate_system\n"
    b"PARAM0_LIST 0 45\nPARAM2_LIST 10 20\nPARAM3_LIST 0 90 180\nDATA binary\n"
) + np.linspace(0.01, 1.0, 36).astype("<f4").tobytes()
KLEMS_BLOCKS = "".join(
    f"<AngleBasisBlock><Theta>{theta}</Theta><nPhis>{count}</nPhis></AngleBasisBlock>\n"
    for theta, count in ((0, 1), (30, 4), (60, 3))
)
KLEMS = (
    '<?xml version="1.0" encoding="UTF-8"?>\n<WindowElement>\n<Optical><Layer><DataDefinition>\n'
    "<IncidentDataStructure>Columns</IncidentDataStructure>\n"
    f"<AngleBasis><AngleBasisName>Own</AngleBasisName>\n{KLEMS_BLOCKS}</AngleBasis></DataDefinition>\n"
    "<WavelengthData><Wavelength>Visible</Wavelength><WavelengthDataBlock>\n"
    "<WavelengthDataDirection>Reflection Front</WavelengthDataDirection>\n"
    "<ColumnAngleBasis>Own</ColumnAngleBasis><RowAngleBasis>Own</RowAngleBasis>\n<ScatteringData>\n"
    + "".join(", ".join(f"0.{row}{column}" for column in range(1, 9)) + ",\n" for row in range(1, 9))
    + "</ScatteringData></WavelengthDataBlock></WavelengthData></Layer></Optical>\n</WindowElement>\n"
)
JDV = "".join(
    f"DataType:\tBRDF(RT-300S)\t \t\nSampleID:\tS\t\nIncidence:\t{i}\t \t\nPolar:\t-40,40,40\t \t\n"
    f"Azimuth:\t-90,-80,10\t \t\n\t\t\t\nRaw data\t\t\t\n\t-40\t0\t40\n-90\t1.{i}\t2.5\t3.5\n"
    f"-80\t4.5\t5.{i}\t6.5\n\t\t\t\n\t\t\t\n"
    for i in (0, 30, 60)
)
RAYWIZ = "".join(
    "DataType:\tBRDF(Raywiz)\t \t\nSampleID:\tS\t \t\nDate:\t7/12/2011\t\t\n1\t1\t2\t\n-90\t-80\t-40\t40\n"
    f"{i}\t\t\t\n1.{i}\t4.5\t\t\n2.5\t5.{i}\t\t\n3.5\t6.5\t\t\n\t\t\t\n"
    for i in (0, 30, 60)
)
LIGHTTOOLS = "".join(
    "Name / Comment :\tS\t \nData file type :\tIntensity BRDF\t\nTheta measure beginning :\t-40\t \n"
    "Theta measure end :\t40\t \nTheta measure step :\t40\t \nPhi measure beginning :\t-90\t \n"
    f"Phi measure end :\t-80\t \nPhi measure step :\t10\t \nTheta Lighting\t{i}\t\n"
    f"-40\t1.{i}\t4.5\n0\t2.5\t5.{i}\n40\t3.5\t6.5\n\t\t\n"
    for i in (0, 30, 60)
)
SPEOS = "".join(
    f"OPTIS - Anisotropic BSDF surface file v1.0\t\t\t\nSampleID:\tSample {i}\t \t\n0 1 0\t\t\t\n"
    "Reflection Spectrum\t\t\t\n2\t\t\t\n100 50\t\t\t\n1000 50\t\t\t\n\t-90\t-80\t\n"
    f"-40\t1.{i}\t4.5\t\n0\t2.5\t5.{i}\t\n40\t3.5\t6.5\t\n\t\t\t\n"
    for i in (0, 30, 60)
)


BANDS = "Theta_i [deg];Theta_o [deg];wavelength [um];BRDF [1/sr]\n".replace("Theta", "theta") + "".join(
    f"{i},5;{o};0,{nm};0,{i}{abs(o)}{nm}\n" for i in (10, 20) for nm in (532, 633) for o in (-30, 15, 40)
)
ASTM_UNCOUNTED = "SAMPLE_ID old lacquer\nVARS theta_i,theta_s,phi_s,R,G,B\n" + "".join(
    f"0.{i},0.{j},{p}.5,0.1{i},0.2{j},0.3{p}\n" for i in (1, 5, 9) for j in (2, 4) for p in (0, 1, 3)
)
ASTM_GERMAN = "NUM_POINTS 8\nVARS theta_i;phi_i;theta_s;phi_s;Integrated\n" + "".join(
    f"0,{i};0;0,{j};3,1;0,25{j}\n" for i in (1, 5) for j in (2, 4, 6, 8)
)
FRED_SCATTERED = "type bsdf_data\nformat angles=rad bsdf=value scale=0.5\n" + "".join(
    f"0.{i} 0.1\n" + "".join(f"0.{j} 2.{i * j} 0.0{i}{j}\n" for j in range(1, 4 + i)) for i in (1, 3, 4)
)
PAB_DSF = (
    '#sample_name "wood"\n#format: theta phi DSF\n#incident_angle 30 0\n#upphi 90\n#colorimetry: CIE-XYZ\n'
) + "".join(f"{t} {p} 0.1{t} 0.2{p} 0.3\n" for t in (10, 20, 60) for p in (0, 90, 200))
SSDD_HALF = (
    "VERSION 0.1\n# as libbsdf writes it\nDATA_TYPE brdf\nCOLOR_MODEL monochrome\n"
    "PARAM_TYPE half_difference_coordinate_system\nREDUCTION_TYPE bilateral_symmetry\n"
    "PARAM0_LIST 0 20 50\nPARAM2_LIST 10 30\nPARAM3_LIST 0 90 180\nSOURCE_TYPE measured\nDATA ascii\n"
) + "".join(f"0.{i}25\n" for i in range(11, 29))
ALTA_HALF = "#DIM 3 3\n#PARAM_IN  RUSIN_TH_TD_PD\n#PARAM_OUT RGB_COLOR\n#VS 1\n" + "".join(
    f"0.{h} 0.{d} 1.{h}{d} 0.1{h} 0.2{d} 0.3 0.01\n" for h in (1, 4, 7) for d in (2, 3, 5)
)
CORNELL_ONE = "1\n632.8\n" + "".join(f"0.{i} 0 1.1 {j}.5 1{i}.{j}e-3\n" for i in (2, 4, 6) for j in range(4))
ALONE = (
    "cornell",
    "alta",
    "radiance",
    "chassis",
    "astm_uncounted",
    "astm_german",
    "alta_half",
    "cornell_one",
)
"""Texts of which each line is a sample of its own."""


@dataclass(frozen=True)
class Whole:
    """A whole file.

    Attributes
    ----------
    path : Path
        Where it lies.
    module : str
        The format's name in `analysis.formats.NAMES`.
    separator : bytes or None
        What separates the cells of a text: blanks where None.
    binary : bool
        Whether it is no text.
    counted : bool
        Whether the format says, anywhere, how many samples there are.
    checked : bool
        Whether checksums cover all values, so that nothing but the same samples may be read.
    alone : bool
        Whether each line is a sample of its own, which says both of its directions.
    """

    path: Path
    module: str
    separator: bytes | None = None
    binary: bool = False
    counted: bool = True
    checked: bool = False
    alone: bool = False


def make_whole_files(folder: Path) -> dict[str, Whole]:
    """Write one file of each format into a folder, under names that say nothing to a reader."""
    texts = {
        "cornell": (CORNELL, "cornell", None, False),
        "alta": (ALTA, "alta", None, False),
        "fred": (FRED, "fred", None, False),
        "radiance": (RADIANCE, "inplane", b",", False),
        "chassis": (CHASSIS, "inplane", None, False),
        "zemax": (ZEMAX, "zemax", None, True),
        "klems": (KLEMS, "klems", None, True),
        "jdv": (JDV, "rt300s_text", None, False),
        "raywiz": (RAYWIZ, "rt300s_text", None, False),
        "lighttools": (LIGHTTOOLS, "rt300s_text", None, False),
        "speos": (SPEOS, "rt300s_text", None, False),
    }
    variants = {
        "bands": (BANDS, "inplane", b";", True),
        "astm_uncounted": (ASTM_UNCOUNTED, "astm", b",", False),
        "astm_german": (ASTM_GERMAN, "astm", b";", True),
        "fred_scattered": (FRED_SCATTERED, "fred", None, False),
        "pab_dsf": (PAB_DSF, "pab", None, False),
        "ssdd_half": (SSDD_HALF, "ssdd", None, True),
        "alta_half": (ALTA_HALF, "alta", None, False),
        "cornell_one": (CORNELL_ONE, "cornell", None, False),
        "jdv_one": (JDV[: JDV.index("DataType", 9)], "rt300s_text", None, False),
    }
    texts |= variants
    files = {}
    for name, (text, module, separator, counted) in texts.items():
        path = folder / f"{name}.dat"
        path.write_bytes(text.encode())
        files[name] = Whole(path, module, separator, counted=counted, alone=name in ALONE)
    grid, one = _grid(), _grid().isel(sample=slice(0, 24))
    _written(grid, folder, "netcdf", ".nc")
    _written(grid, folder, "csv", ".csv")
    _written(grid, folder, "astm", ".astm")
    _written(grid, folder, "ssdd", ".ssdd")
    _written(one.isel(channel=[0]), folder, "pab", ".pab")
    np.savez(folder / "npz.npz", wi=grid["wi"], wo=grid["wo"], f_r=grid["f_r"])
    (folder / "npz.npz").rename(folder / "npz.dat")
    write_tensors(folder / "rgl.dat", _tensors())
    german = (folder / "csv.dat").read_text().replace(",", ";").replace(".", ",").replace("632,8n", "632.8n")
    (folder / "csv_german.dat").write_text(german)
    files["csv_german"] = Whole(folder / "csv_german.dat", "csv", b";", alone=True)
    files["csv"] = Whole(folder / "csv.dat", "csv", b",", alone=True)
    files["astm"] = Whole(folder / "astm.dat", "astm", b",", alone=True)
    files["ssdd"] = Whole(folder / "ssdd.dat", "ssdd")
    (folder / "ssdd_binary.dat").write_bytes(SSDD_BINARY)
    files["ssdd_binary"] = Whole(folder / "ssdd_binary.dat", "ssdd", binary=True)
    files["pab"] = Whole(folder / "pab.dat", "pab", counted=False)
    for name in ("netcdf", "npz", "rgl"):
        files[name] = Whole(folder / f"{name}.dat", name, binary=True, checked=name != "rgl")
    return files


def make_merl(folder: Path) -> Whole:
    """Write a MERL table, of the one size that they have."""
    path = folder / "merl.dat"
    values = np.random.default_rng(4).random((3, 90 * 90 * 180))
    path.write_bytes(np.array([90, 90, 180], "<i4").tobytes() + values.astype("<f8").tobytes())
    return Whole(path, "merl", binary=True)


def _written(samples: xr.Dataset, folder: Path, name: str, suffix: str) -> None:
    write(samples, folder / f"{name}{suffix}")
    (folder / f"{name}{suffix}").rename(folder / f"{name}.dat")


def _grid() -> xr.Dataset:
    """Make samples on a full grid of 2 x 1 x 4 x 6 directions."""
    grid = np.meshgrid([10.0, 60.0], [0.0], [5.0, 20.0, 40.0, 70.0], np.arange(6) * 60.0, indexing="ij")
    theta_i, phi_i, theta_o, phi_o = np.radians([axis.ravel() for axis in grid])
    values = np.random.default_rng(2).uniform(0.01, 1.0, (theta_i.size, 2))
    return make_samples(
        spherical_to_direction(theta_i, phi_i),
        spherical_to_direction(theta_o, phi_o),
        values,
        wavelength_nm=[450.0, 632.8],
        u_noise=0.01 * values,
    )


def _tensors() -> dict[str, np.ndarray]:
    """Make a measured BSDF of 3 incidences with 6 x 6 nodes."""
    random = np.random.default_rng(3)
    return {
        "theta_i": np.array([0.0, 0.6, 1.2], np.float32),
        "phi_i": np.zeros(1, np.float32),
        "sigma": np.full((2, 8), 0.25, np.float32),
        "ndf": random.uniform(0.5, 1.0, (2, 8)).astype(np.float32),
        "vndf": random.uniform(0.5, 1.0, (1, 3, 6, 6)).astype(np.float32),
        "luminance": random.uniform(0.5, 1.0, (1, 3, 6, 6)).astype(np.float32),
        "rgb": random.uniform(0.1, 0.5, (1, 3, 3, 6, 6)).astype(np.float32),
        "jacobian": np.ones(1, np.uint8),
        "description": np.frombuffer(b"hand-made", np.uint8),
    }
