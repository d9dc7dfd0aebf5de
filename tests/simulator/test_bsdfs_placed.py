"""The BSDF of a sample with axes, relief and pattern: drawn as its density says, reciprocal, no light."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from scipy.stats import norm

from rig.angles import spherical_to_direction
from rig.description import default_rig
from simulator import bsdfs
from simulator.light import mitsuba_scene
from simulator.light.scene import Event, Scene
from simulator.materials import parse_material
from simulator.variant import LLVM, choose_variant, load_mitsuba

if TYPE_CHECKING:
    from pathlib import Path

pytestmark = pytest.mark.render

SIGNIFICANCE, SAMPLES = 0.01, 200_000
GLOSSY = "ggx:kd=0.3,ks=0.6,alpha=0.3,f0=0.08"
BRUSHED = "ggx-anisotropic:kd=0.3,ks=0.6,alpha_x=0.15,alpha_y=0.4,f0=0.08,axis_rad=0.3"
LINES = [
    f"{BRUSHED}@turned:deg=35",
    f"{GLOSSY}@rough:slope_rms=0.15,wavelength_mm=8,seed=4",
    f"{BRUSHED}@turned:deg=35@rough:slope_rms=0.1,wavelength_mm=5",
    f"{GLOSSY}@checker:side_mm=6,kd=0.6,alpha=0.6",
    f"{GLOSSY}@gradient:kd=0.6,alpha=0.6,along_deg=30",
    f"{GLOSSY}@tilted:x_deg=12,y_deg=-7",
]
THETAS_DEG = (20.0, 70.0)
PLACE_MM = (7.0, -4.0, 0.0)
"""Where the light falls: on no axis, and in no middle of a pattern."""


@pytest.fixture
def mi() -> Any:
    """Mitsuba vectorised, with our BSDFs."""
    if choose_variant().variant != LLVM:
        pytest.skip("no LLVM here")
    found = load_mitsuba(LLVM)
    bsdfs.register(found)
    return found


class At:
    """A placed BSDF at a point of its sample."""

    def __init__(self, mi: Any, line: str) -> None:
        material = parse_material(line)
        shape = mitsuba_scene.sample(mi, Scene(default_rig(), material, frozenset({Event.GLOSSY})))
        self.mi, self.bsdf = mi, shape["bsdf"]
        matrix = np.array(shape["to_world"].matrix)
        self._normal = matrix[:3, 2] / np.linalg.norm(matrix[:3, 2])
        across = np.array([PLACE_MM[0], PLACE_MM[1], 0.0])
        self._point = matrix[:3, 3] + across - (across @ self._normal) * self._normal

    def meet(self, wi: Any, count: int) -> Any:
        """Return an interaction of light that comes from a direction of the shape's own frame."""
        mi = self.mi
        si = self._zeros(count)
        si.p = mi.Point3f(*self._point.tolist())
        si.n = mi.Normal3f(*self._normal.tolist())
        si.sh_frame = mi.Frame3f(si.n)
        si.wi = mi.Vector3f(wi)
        return si

    def _zeros(self, count: int) -> Any:
        import drjit as dr

        return dr.zeros(self.mi.SurfaceInteraction3f, count)

    def sample(self, sample: Any, wi: Any) -> tuple[Any, Any]:
        """Draw directions, as Mitsuba's test wants them: with weight 0 where no light goes."""
        import drjit as dr

        mi = self.mi
        si = self.meet(wi, dr.width(sample))
        found, weight = self.bsdf.sample(mi.BSDFContext(), si, sample[0], mi.Point2f(sample[1], sample[2]))
        return found.wo, dr.select(dr.all(weight == 0.0), mi.Float(0.0), mi.Float(1.0))

    def density(self, wo: Any, wi: Any) -> Any:
        """Density of directions."""
        import drjit as dr

        return self.bsdf.pdf(self.mi.BSDFContext(), self.meet(wi, dr.width(wo)), wo)

    def f_r(self, wi: Any, wo: Any) -> Any:
        """f_r (N, 3) of light from wi seen from wo, both (N, 3)."""
        mi = self.mi
        si = self.meet(wo.T.astype(np.float32), len(wo))
        value = self.bsdf.eval(mi.BSDFContext(), si, mi.Vector3f(wi.T.astype(np.float32)))
        return np.asarray(value, dtype=np.float64).T / wi[:, 2:]


def from_angle(theta_deg: float) -> list[float]:
    """Direction at an angle, on no axis."""
    direction = spherical_to_direction(np.radians(theta_deg), np.asarray(0.4))
    return [float(component) for component in direction.ravel()]


def test_every_registered_bsdf_has_its_tests(monkeypatch: pytest.MonkeyPatch) -> None:
    """Would catch a BSDF that is registered, and that nobody holds against its density, energy, reciprocity.

    The models of the first are all drawn in `test_bsdfs_sampling`; the second is drawn here.
    """

    class Told:
        def __init__(self, mi: Any) -> None:
            self.mi = mi
            self.names: list[str] = []

        def __getattr__(self, name: str) -> Any:
            return getattr(self.mi, name)

        def variant(self) -> str:
            return "another"

        def register_bsdf(self, name: str, _: Any) -> None:
            self.names.append(name)

    told = Told(load_mitsuba("scalar"))
    monkeypatch.setattr(bsdfs, "_registered", set())
    bsdfs.register(told)
    assert told.names == [bsdfs.PLUGIN, bsdfs.PLACED]


@pytest.mark.parametrize("line", LINES)
@pytest.mark.parametrize("theta_deg", THETAS_DEG)
def test_directions_follow_their_density(
    mi: Any, line: str, theta_deg: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Would catch axes turned one way only, a relief that the density does not know, shares mixed up."""
    from mitsuba import chi2

    chi_square_test: Any = chi2.ChiSquareTest
    monkeypatch.chdir(tmp_path)  # a failed test leaves its tables there
    at, wi = At(mi, line), from_angle(theta_deg)
    test = chi_square_test(
        chi2.SphericalDomain(),
        lambda sample: at.sample(sample, wi),
        lambda wo: at.density(wo, wi),
        3,
        SAMPLES,
        res=101,
        ires=16,
    )
    assert test.run(SIGNIFICANCE, test_count=len(LINES) * len(THETAS_DEG), quiet=True), test.messages


@pytest.mark.parametrize("line", [line for line in LINES if "rough" not in line])
def test_light_and_camera_may_change_places(mi: Any, line: str) -> None:
    """Would catch a pattern or a turn that is asked for one direction only."""
    random = np.random.default_rng(5)
    theta, phi = np.arccos(random.uniform(0.1, 1.0, (2, 400))), random.uniform(0.0, 2.0 * np.pi, (2, 400))
    wi, wo = spherical_to_direction(theta, phi)
    at = At(mi, line)
    there, back = at.f_r(wi, wo), at.f_r(wo, wi)
    np.testing.assert_allclose(there, back, rtol=2e-5)
    assert there.min() > 0.0


@pytest.mark.parametrize("line", LINES)
def test_no_light_is_made_and_sampling_carries_all_of_it(mi: Any, line: str) -> None:
    """Would catch weights that are not value over density, and a mixture that sends out more than came."""
    import drjit as dr

    at = At(mi, line)
    for theta_deg in (10.0, 60.0):
        wi = from_angle(theta_deg)
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(3, SAMPLES)
        si = at.meet(wi, SAMPLES)
        _, weight = at.bsdf.sample(mi.BSDFContext(), si, sampler.next_1d(), sampler.next_2d())
        drawn = np.asarray(weight, dtype=np.float64)[0]
        drawn = np.broadcast_to(drawn, (SAMPLES,))
        # The same integral with directions that know nothing of the lobe.
        evenly = mi.warp.square_to_cosine_hemisphere(sampler.next_2d())
        value = at.bsdf.eval(mi.BSDFContext(), si, evenly)
        even = np.asarray(value, dtype=np.float64)[0] * np.pi / np.asarray(dr.maximum(evenly.z, 1e-6))
        error = np.hypot(drawn.std(), even.std()) / np.sqrt(SAMPLES)
        bound = norm.isf(0.5 * SIGNIFICANCE / (2 * len(LINES)))
        assert abs(drawn.mean() - even.mean()) <= bound * error
        assert drawn.mean() <= 1.0 + bound * drawn.std() / np.sqrt(SAMPLES)
