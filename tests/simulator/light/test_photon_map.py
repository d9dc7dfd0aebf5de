"""Photons of mirrors against closed forms: lamps in planar mirrors, and rays that a hollow mirror gathers."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from rig.description import Rig, default_rig
from rig.errors import BadInput
from rig.pixels import pixel_geometry
from simulator.light.choice import Chooser
from simulator.light.methods import METHODS
from simulator.light.path_classes import PathClasses
from simulator.light.paths import LightPaths
from simulator.light.photon_map import PhotonMap, PhotonMapMethod
from simulator.light.photons import PhotonTracer
from simulator.light.reflectance import material_reflectance
from simulator.light.scene import Event, Housing, PlanarMirror, Scene, SphericalMirror
from simulator.light.virtual_lights import VirtualLights
from simulator.materials import parse_material

if TYPE_CHECKING:
    from simulator.light.scene import Mirror

ANGLES: Any = np.radians([30.0, 20.0, 15.0, 0.0])
BOUNCED = LightPaths("LS+DE")
LAMP = np.array([0.0, 0.0, 500.0])
PLANE = PlanarMirror((-80.0, 0.0, 0.0), (0.0, 600.0, 0.0), (0.0, 0.0, 600.0), 0.9)
WINDOW = PlanarMirror((-120.0, 0.0, 80.0), (0.0, 30.0, 0.0), (0.0, 0.0, 30.0), 0.9)
LEANING = PlanarMirror((-60.0, 0.0, 60.0), (0.0, 60.0, 0.0), (32.0, 0.0, 24.0), 0.9)
"""It shows the sample to itself."""
GLOSSY = "cook-torrance:kd=0.2,ks=0.6,m=0.3,ior=1.5"


def scene(*mirrors: Mirror, spec: str = "lambert:kd=1", rig: Rig | None = None, **more: Any) -> Scene:
    """Return the default rig with a sample, beside mirrors."""
    event = Event.LAMBERTIAN if spec.startswith("lambert") else Event.GLOSSY
    return Scene(rig or default_rig(), parse_material(spec), frozenset({event}), mirrors=mirrors, **more)


def photon_map(mi: Any, what: Scene, paths: LightPaths = BOUNCED) -> PhotonMap:
    """Return the evaluator."""
    return PhotonMap(mi, what, material_reflectance(mi, what.material), paths)


def rms(found: Any, wanted: Any) -> float:
    """RMS error over pixels, relative to their mean."""
    return float(np.sqrt(np.mean((found - wanted) ** 2)) / wanted.mean())


class Rays:
    """A point lamp on the axis of a mirror above the sample, in the plane that holds the axis: exact.

    Rays leave the lamp upwards at an angle from the axis, meet the sphere, and come down to the sample.
    """

    def __init__(self, mirror: SphericalMirror) -> None:
        self._radius, self._centre = abs(mirror.radius_mm), mirror.centre_mm[2]
        self._sign = np.sign(mirror.radius_mm)
        # What the rim cuts off, met from the lamp.
        rim_height = mirror.vertex_mm[2] - self._sign * mirror.depth_mm
        self.widest = float(np.arctan2(mirror.rim_mm, rim_height - LAMP[2]))

    def landing_mm(self, angle: Any) -> Any:
        """Return the distance from the axis at which rays meet the sample; negative beyond the axis."""
        way = np.stack([np.sin(angle), np.cos(angle)], axis=-1)
        start = np.array([0.0, LAMP[2] - self._centre])
        along = way @ start
        # A hollow mirror is met from inside, at the far end of the chord.
        chord = np.sqrt(along**2 - start @ start + self._radius**2)
        met = start + (-along + self._sign * chord)[:, None] * way
        normal = met / self._radius
        down = way - 2.0 * np.sum(way * normal, axis=1, keepdims=True) * normal
        return met[:, 0] - (met[:, 1] + self._centre) / down[:, 1] * down[:, 0]

    def within(self, radius_mm: float) -> float:
        """Flux of a unit intensity inside a circle on the sample."""
        edges = np.linspace(0.0, self.widest, 400_001)
        middles = 0.5 * (edges[1:] + edges[:-1])
        inside = np.abs(self.landing_mm(middles)) <= radius_mm
        return float(2.0 * np.pi * np.sum((np.cos(edges[:-1]) - np.cos(edges[1:]))[inside]))


HOLLOW = SphericalMirror((0.0, 0.0, 800.0), (0.0, 0.0, -1.0), 520.0, 100.0, 0.8)
FOLD = SphericalMirror((0.0, 0.0, 800.0), (0.0, 0.0, -1.0), 450.0, 150.0, 0.8)
"""Its rays are gathered in a ring, beyond which it is dark."""
BALL = SphericalMirror((0.0, 0.0, 800.0), (0.0, 0.0, -1.0), -700.0, 100.0, 0.8)


@pytest.mark.render
class TestClosedForm:
    @pytest.mark.parametrize("mirror", [HOLLOW, BALL], ids=["hollow", "ball"])
    def test_flux_within_circles(self, vector: Any, mirror: SphericalMirror) -> None:
        """Would catch a sphere of the wrong side, lost reflectance, and light where no ray goes."""
        what = scene(mirror, lamp_cosine=False)
        tracer = PhotonTracer(vector, what, lambda wi, _: wi, BOUNCED)
        photons = tracer.trace(LAMP, 1 << 16, 1)
        distance = np.linalg.norm(photons.places_mm, axis=1)
        rays = Rays(mirror)
        for radius_mm in (3.0, 8.0, 15.0, 25.0):
            wanted = 0.8 * what.lamp_intensity * rays.within(radius_mm)
            assert wanted > 0.0
            found = photons.power[distance <= radius_mm].sum(axis=0)
            np.testing.assert_allclose(found, wanted, rtol=5e-3)

    def test_intensity_of_a_caustic(self, vector: Any) -> None:
        """Would catch a density that is not light over area: a ring eight times as bright as its middle."""
        what = scene(FOLD, lamp_cosine=False)
        pixels = pixel_geometry(what.rig, np.zeros(4))
        radiance = photon_map(vector, what).render((0.0,) * 4, 0.1).radiance[pixels.on_sample][:, 0]
        angle = np.linspace(0.0, Rays(FOLD).widest, 200_001)
        flux = 0.8 * what.lamp_intensity * 2.0 * np.pi * -np.diff(np.cos(angle))
        edges = np.arange(0.0, 20.0)
        lit, _ = np.histogram(np.abs(Rays(FOLD).landing_mm(angle))[1:], edges, weights=flux)
        wanted = lit / (np.pi * np.diff(edges**2)) / np.pi
        # The camera is above: pixels lie evenly on the sample.
        distance = np.linalg.norm(pixels.position_mm[pixels.on_sample], axis=-1)
        count, _ = np.histogram(distance, edges)
        total, _ = np.histogram(distance, edges, weights=radiance)
        found = total / np.maximum(count, 1)
        ring = int(np.argmax(wanted))
        assert int(np.argmax(found)) == ring
        assert wanted[ring] > 8.0 * wanted[0]
        assert rms(found[: ring - 1], wanted[: ring - 1]) < 0.02
        assert found[ring] == pytest.approx(wanted[ring], rel=0.15)
        np.testing.assert_allclose(found[ring + 2 :], 0.0, atol=0.02 * wanted[0])

    def test_scalar_photons_arrive_alike(self, scalar: Any) -> None:
        """Would catch a variant that follows other photons."""
        what = scene(HOLLOW, lamp_cosine=False)
        photons = PhotonTracer(scalar, what, lambda wi, _: wi, BOUNCED).trace(LAMP, 1 << 10, 1)
        inside = np.linalg.norm(photons.places_mm, axis=1) <= 25.0
        wanted = 0.8 * what.lamp_intensity * Rays(HOLLOW).within(25.0)
        np.testing.assert_allclose(photons.power[inside].sum(axis=0), wanted, rtol=0.02)


@pytest.mark.render
class TestVirtualLightsAreTheTruth:
    @pytest.mark.parametrize("spec", ["lambert:kd=1", GLOSSY])
    @pytest.mark.parametrize(("mirror", "tolerance"), [(PLANE, 0.02), (WINDOW, 0.2)], ids=["plane", "window"])
    def test_error_is_as_stated(self, vector: Any, mirror: PlanarMirror, spec: str, tolerance: float) -> None:
        """Would catch light lost or doubled, an f_r of the wrong directions, an error not known."""
        what = scene(mirror, spec=spec)
        seen = pixel_geometry(what.rig, ANGLES).on_sample
        exact = VirtualLights(what, material_reflectance(vector, what.material), BOUNCED)
        wanted = exact.render(ANGLES, 1e-4).radiance[seen]
        found = photon_map(vector, what).render(ANGLES, tolerance)
        error = rms(found.radiance[seen], wanted)
        assert found.error <= tolerance
        assert 0.3 * found.error < error < 2.0 * found.error

    @pytest.mark.slow
    def test_error_falls_with_more_photons(self, vector: Any, monkeypatch: pytest.MonkeyPatch) -> None:
        """Would catch an estimate that stops getting better, or says so while it does."""
        from simulator.light import photon_map as module

        what = scene(WINDOW)
        seen = pixel_geometry(what.rig, ANGLES).on_sample
        exact = VirtualLights(what, material_reflectance(vector, what.material), BOUNCED)
        wanted = exact.render(ANGLES, 1e-4).radiance[seen]
        errors = []
        for power in (11, 14, 17):
            monkeypatch.setattr(module, "_COUNTS", (1 << power,))
            found = photon_map(vector, what).render(ANGLES, 1e-3)
            errors.append((found.error, rms(found.radiance[seen], wanted)))
        # Of an edge, the square of the error falls as the cube root of the number, or faster.
        for before, after in itertools.pairwise(errors):
            assert after[0] < 0.75 * before[0]
            assert after[1] < 0.75 * before[1]


@pytest.mark.render
class TestScatteredBefore:
    def test_sample_lights_itself_over_a_mirror(self, vector: Any) -> None:
        """Would catch a first event without its f_r, its cosine or its area, against the path tracer."""
        what = scene(LEANING, spec=GLOSSY)
        self.compare(vector, what, LightPaths("LDgSDgE"), 4)

    def test_light_comes_back_twice(self, vector: Any) -> None:
        """Would catch a second return without its f_r, or photons that start from the same place again."""
        # From the middle of its sphere, a hollow mirror throws all light back there.
        mirror = SphericalMirror((-96.0, 0.0, 72.0), (0.8, 0.0, -0.6), 120.0, 50.0, 0.9)
        what = scene(mirror, spec="lambert:kd=0.9")
        self.compare(vector, what, LightPaths("LDlSDlSDlE"), 4)

    @pytest.mark.slow
    def test_walls_light_it_over_a_hollow_mirror(self, vector: Any) -> None:
        """Would catch walls without their albedo or with the wrong normal, against the path tracer."""
        mirror = SphericalMirror((-150.0, 0.0, 100.0), (1.0, 0.0, -0.4), 300.0, 80.0, 0.9)
        what = scene(mirror, housing=Housing(0.5, 600.0))
        self.compare(vector, what, LightPaths("LDlSDlE"), 4)

    @staticmethod
    def compare(mi: Any, what: Scene, paths: LightPaths, renders: int) -> None:
        """Compare means over the sample with those of path classes, which come from the camera."""
        seen = pixel_geometry(what.rig, ANGLES).on_sample
        found = photon_map(mi, what, paths).render(ANGLES, 0.1)
        (wanted,) = PathClasses(mi, what, [paths], longest=5, samples_per_pixel=32).estimates(ANGLES, renders)
        mean = wanted.mean[seen].mean()
        assert mean > 0.0
        noise = np.sqrt(np.mean(wanted.standard_error[seen] ** 2) / seen.sum()) / mean
        assert found.radiance[seen].mean() == pytest.approx(mean, rel=4.0 * noise + 0.5 * found.error + 0.01)


class TestChoice:
    def test_only_photons_serve_a_curved_mirror(self, scalar: Any) -> None:
        """Would catch virtual lights in a hollow mirror, where the lamp's image is nowhere."""
        chooser = Chooser(scalar, scene(HOLLOW), 0.05, METHODS)
        direct, once = chooser.classes[:2]
        assert once.name == "LSDlE"
        assert [method.name for method in chooser.able(once)] == [PhotonMapMethod.name]
        decision = chooser.decide(ANGLES)
        by = {path_class: part.method.name for part in decision.parts for path_class in part.classes}
        assert by[once] == PhotonMapMethod.name
        assert by[direct] != PhotonMapMethod.name

    def test_planar_mirrors_keep_their_virtual_lights(self, scalar: Any) -> None:
        """Would catch photons where images are exact."""
        chooser = Chooser(scalar, scene(PLANE), 0.05, METHODS)
        once = next(path_class for path_class in chooser.classes if path_class.name == "LSDlE")
        part = chooser.decide(ANGLES).by(once)
        assert part is not None
        assert part.method.name == "virtual lights"


@pytest.mark.parametrize(
    "wrong",
    [
        {"radius_mm": 0.0},
        {"rim_mm": 0.0},
        {"rim_mm": 200.0},
        {"facing": (0.0, 0.0, 0.0)},
        {"reflectance": 1.5},
        {"radius_mm": float("nan")},
    ],
)
def test_mirrors_that_are_none_are_refused(wrong: dict[str, Any]) -> None:
    """Would catch a traceback, or a picture of nothing, from a mirror that cannot be."""
    right = {"vertex_mm": (0.0, 0.0, 1.0), "facing": (0.0, 0.0, 1.0), "radius_mm": 100.0, "rim_mm": 50.0}
    SphericalMirror(**right)  # type: ignore[arg-type]
    with pytest.raises(BadInput):
        SphericalMirror(**(right | wrong))  # type: ignore[arg-type]
