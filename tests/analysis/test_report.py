"""The report: self-contained, complete, safe to open, the same every time; and the numbers it prints."""

from __future__ import annotations

import base64
import re
from dataclasses import replace
from html.parser import HTMLParser
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from analysis.evaluation import evaluate_fit, view_angles
from analysis.figures import incidences
from analysis.fit import fit
from analysis.measurement import Image, Mosaic
from analysis.models import MODELS
from analysis.report import Measurement, ShownFrame, build_page, write_report
from analysis.samples import make_samples
from analysis.table import Row, parameter_rows, rounded, text_table
from capture.merge import Flag

if TYPE_CHECKING:
    from pathlib import Path

    import xarray as xr

TRUTH = {"kd": (0.3, 0.2, 0.1), "ks": 0.5, "m": 0.25, "ior": 1.5}
PNG = base64.b64decode(
    "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mNk+M9QDwADhgGAWjR9awAAAABJRU5ErkJggg=="
)


def _scan(theta_i_deg: float, theta_o_deg: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    ti, to = np.deg2rad(theta_i_deg), np.deg2rad(theta_o_deg)
    wi = np.broadcast_to([np.sin(ti), 0.0, np.cos(ti)], (to.size, 3))
    return wi, np.stack([-np.sin(to), np.zeros_like(to), np.cos(to)], axis=-1)


@pytest.fixture(scope="module")
def samples() -> xr.Dataset:
    """In-plane scans of a rough dielectric, with every uncertainty column."""
    rng = np.random.default_rng(0)
    parts = [_scan(angle, np.repeat(np.arange(-70.0, 75.0, 5.0), 4)) for angle in (20.0, 45.0, 65.0)]
    wi, wo = (np.concatenate([part[side] for part in parts]) for side in (0, 1))
    f = MODELS["cook-torrance"](**TRUTH).evaluate(wi, wo)
    count = len(f)
    u = 0.004 * f
    pose = np.arange(count) // 4
    joint = np.zeros((count, 4, 3))
    joint[:, 0] = np.cross([0.0, 1.0, 0.0], wi)
    table = make_samples(
        wi,
        wo,
        f + u * rng.standard_normal(f.shape),
        channels=["R", "G", "B"],
        u_noise=u,
        u_white=0.2 * u,
        white_group=np.arange(count),
        u_reference=0.0005 * f,
        u_binning=0.01 * u,
        pose=pose,
        d_wi=joint,
        d_wo=np.zeros((count, 4, 3)),
        u_joint_rad=np.full(4, 4e-4),
    )
    table.attrs |= {"pixels_hot": 12, "dropped_few_pixels": 34}
    return table


@pytest.fixture(scope="module")
def measurement(samples: xr.Dataset) -> Measurement:
    """Everything that a section can show."""
    rng = np.random.default_rng(1)
    radiance = 1000 + 300 * rng.random((24, 32))
    flags = np.zeros((24, 32), dtype=np.uint8)
    flags[3, 4] = Flag.HOT
    frame = ShownFrame(
        Image(radiance, np.full(radiance.shape, 25.0), flags, np.zeros(4)),
        Mosaic.repeat(np.array([[0, 1], [1, 2]]), ("R", "G", "B"), (24, 32)).channel,
        "Pose 7",
    )
    return Measurement(
        "Sample <A> & B",
        samples,
        [fit(samples, "cook-torrance"), fit(samples, "lambert")],
        truth=TRUTH | {"ks_F0": 0.02},
        frame=frame,
        sphere_png=PNG,
        exposure_s={"sample": [0.01, 0.02, 0.01], "white": [0.01], "dark": [0.01, 0.02]},
        facts={"Session": "<script>alert(1)</script>"},
    )


class _Strict(HTMLParser):
    """Checks that tags nest and collects what could reach outside."""

    VOID = frozenset({"meta", "img", "br", "link", "input", "hr"})

    def __init__(self) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.sources: list[str] = []
        self.tags: set[str] = set()
        self.text = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        self.sources += [value or "" for name, value in attrs if name in {"src", "href", "srcset", "style"}]
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data


def _parsed(page: str) -> _Strict:
    parser = _Strict()
    parser.feed(page)
    parser.close()
    assert not parser.open
    return parser


@pytest.fixture(scope="module")
def page(measurement: Measurement) -> str:
    """Give the whole page."""
    return build_page("A report", [measurement], lead="Lead", facts={"Rig hash": "ab" * 32})


def test_page_is_self_contained_and_escapes_names(page: str) -> None:
    """Catches links to the outside, scripts, and names from files that become markup."""
    parsed = _parsed(page)
    assert "script" not in parsed.tags
    assert all(source.startswith(("data:image/", "#")) for source in parsed.sources)
    assert "url(" not in page
    assert "@import" not in page
    assert "<script>alert(1)</script>" in parsed.text
    assert "Sample <A> & B" in parsed.text
    assert len(page) < 5_000_000


def test_pictures_inside_reach_nothing_outside(page: str) -> None:
    """Catches SVG with external references or scripts, which a viewer would load."""
    pictures = re.findall(r'src="data:image/svg\+xml;base64,([^"]+)"', page)
    assert len(pictures) == 6
    for picture in pictures:
        svg = base64.b64decode(picture).decode()
        assert "<script" not in svg
        links = re.findall(r'(?:xlink:)?href="([^"]*)"', svg)
        assert all(link.startswith(("#", "data:")) for link in links)


def test_page_says_what_a_scientist_asks(page: str) -> None:
    """Catches a section that went missing."""
    text = _parsed(page).text
    for wanted in (
        "Parameters", "Pose coverage", "One merged frame", "Lobes", "Residuals", "Uncertainty budget",
        "Exposures and flags", "True", "Recovered", "Pull", "ab" * 32, "few pixels", "rendered by Mitsuba",
    ):  # fmt: skip
        assert wanted in text


def test_page_says_what_dominates_the_uncertainty(page: str) -> None:
    """A budget without the joints, or one that names noise for what does not average out."""
    section = page.partition("What dominates")[2].partition("</table>")[0]

    for name in ("noise of the sample", "noise of the white", "reflectance of the white", "angle of joint 0"):
        assert name in section
    assert "A single sample is limited by the noise of the sample" in section
    assert "the mean of all by the reflectance of the white" in section


def test_the_same_inputs_give_the_same_page(measurement: Measurement, page: str) -> None:
    """Catches dates, random ids and hash order in the page."""
    assert build_page("A report", [measurement], lead="Lead", facts={"Rig hash": "ab" * 32}) == page


def test_sparse_samples_give_a_page_too(tmp_path: Path) -> None:
    """Catches a report that needs poses, uncertainties, scans, a frame or a truth to be drawn."""
    rng = np.random.default_rng(3)
    direction = rng.standard_normal((40, 2, 3))
    direction[..., 2] = np.abs(direction[..., 2]) + 0.2
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    wi, wo = direction[:, 0], direction[:, 1]
    values = np.full((40, 1), 0.1) + 0.001 * rng.standard_normal((40, 1))
    values[3] = np.nan
    bare = make_samples(wi, wo, values, wavelength_nm=[550.0])
    write_report(tmp_path / "r.html", "Bare", [Measurement("Bare", bare, [fit(bare, "lambert")])])
    text = _parsed((tmp_path / "r.html").read_text(encoding="utf-8")).text
    assert "Lobes" not in text
    assert "no stated uncertainty" not in text  # that stands inside the picture
    write_report(tmp_path / "r.html", "Bare", [Measurement("Bare", bare), Measurement("Again", bare)])
    assert "Again" in (tmp_path / "r.html").read_text(encoding="utf-8")


def test_pulls_of_a_right_model_are_standard_normal(samples: xr.Dataset) -> None:
    """Catches a pull over the wrong columns: reference shared by all must not be in it, pose must be."""
    model = MODELS["cook-torrance"](**TRUTH)
    evaluation = evaluate_fit(samples, model)
    own = evaluate_fit(samples.drop_vars(["d_wi", "d_wo", "u_joint_rad"]), model)
    assert own.pull.std() == pytest.approx(1 / np.hypot(1, 0.2), abs=0.05)
    assert (evaluation.columns["pose"] >= 0).all()
    assert (np.abs(evaluation.pull) <= np.abs(own.pull) + 1e-12).all()
    step = 1e-6
    wi, wo = samples["wi"].to_numpy(), samples["wo"].to_numpy()
    turned = wi + step * samples["d_wi"].to_numpy()[:, 0]
    slope = (model.evaluate(turned, wo) - model.evaluate(wi, wo)) / step
    close = np.isclose(evaluation.columns["pose"], np.abs(slope) * 4e-4, rtol=1e-3, atol=1e-8)
    assert close.mean() > 0.98  # the rest lie on the kink of the V-groove term


def test_signed_camera_angle_is_positive_on_the_mirrors_side() -> None:
    """Catches a lobe drawn on the light's side."""
    wi, wo = _scan(40.0, np.array([40.0, -30.0, 0.0]))
    view = view_angles(wi, wo)
    np.testing.assert_allclose(np.rad2deg(view.signed_theta_o), [40.0, -30.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(view.off_plane, 0.0, atol=1e-12)
    assert view.theta_h[0] == pytest.approx(0.0, abs=1e-7)
    aside = np.array([[0.0, np.sin(0.3), np.cos(0.3)]])
    assert abs(view_angles(wi[:1], aside).off_plane[0]) == pytest.approx(0.3)


def test_scans_are_found_by_their_light(samples: xr.Dataset) -> None:
    """Catches lobes drawn at angles where the light never stood."""
    np.testing.assert_allclose(np.rad2deg(incidences(samples)), [20.0, 45.0, 65.0], atol=0.05)


@given(st.floats(-1e6, 1e6), st.floats(1e-8, 1e3))
def test_two_significant_digits_of_the_uncertainty(value: float, u: float) -> None:
    """Catches values printed with fewer digits than their uncertainty allows."""
    shown, shown_u = rounded(value, u)
    assert abs(float(shown) - value) <= 0.51 * max(u, 1e-9 * abs(value)) + 1e-6 * abs(value) * (u < 1e-8)
    assert float(shown_u) == pytest.approx(u, rel=0.06)


def test_numbers_without_meaning_are_not_dressed_up() -> None:
    """Catches NaN or infinity with digits."""
    assert rounded(0.5, np.inf) == ("0.5", "")
    assert rounded(0.5, 0.0) == ("0.5", "0")


def test_rows_hold_every_number_once(measurement: Measurement) -> None:
    """Catches channels mixed up with true values, and derived quantities left out."""
    rows = parameter_rows(measurement.fits[0], ["R", "G", "B"], measurement.truth)
    labels = [(row.name, row.channel) for row in rows]
    assert len(set(labels)) == len(labels)
    by_channel = {(name, channel) for name in ("kd", "ks", "ks_F0") for channel in "RGB"}
    assert set(labels) == by_channel | {("m", ""), ("ior", "")}
    by_key = {(row.name, row.channel): row for row in rows}
    assert by_key["kd", "B"].true == 0.1
    assert by_key["m", ""].true == 0.25
    assert by_key["kd", "R"].pull == pytest.approx((by_key["kd", "R"].value - 0.3) / by_key["kd", "R"].u)


def test_text_table_lines_up() -> None:
    """Catches columns that do not align, and a pull printed without a truth."""
    rows = [Row("kd", "R", 0.61976, 0.00031, 0.62), Row("exponent", "", 29.993, 0.019, None)]
    lines = text_table(rows).splitlines()
    assert lines[1].split() == ["kd", "R", "0.62", "0.61976", "0.00031", "-0.77"]
    assert lines[2].split() == ["exponent", "29.993", "0.019"]
    assert lines[1].index("0.61976") + 7 == lines[2].index("29.993") + 6


def test_far_parameters_stand_out(measurement: Measurement) -> None:
    """Catches a wrong fit that looks like a right one."""
    wrong = replace(measurement, truth={"kd": 0.9})
    assert 'class="far"' in build_page("x", [wrong], lead="", facts={})
