"""Lamps, pixels and pupils with a size, by adaptive quadrature: right, no finer than needed, and honest."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from analysis.instrument import disc_nodes
from rig.description import Camera, Rig, default_rig
from rig.kinematics import Kinematics
from rig.pixels import pixel_geometry
from simulator.light import direct
from simulator.light.direct import DirectFloat64, DirectLight, DirectMitsuba
from simulator.light.direct_float64 import Float64Nodes
from simulator.light.direct_llvm import MitsubaNodes
from simulator.light.direct_view import POINTS, Extents, extents_of, half_plane_share
from simulator.light.paths import LightPaths
from simulator.light.pixelwise import PixelwiseLight
from simulator.light.reflectance import closed_form_reflectance
from simulator.light.scene import Event, Scene
from simulator.light.sparse_rules import CENTRES, Levels, combination_weight, product_rule, sparse_rule
from simulator.materials import ClosedFormMaterial, parse_material

if TYPE_CHECKING:
    from numpy.typing import NDArray

Array = "NDArray[np.float64]"

RIG = default_rig(
    camera=Camera(width_px=40, height_px=32, focal_length_px=330.0, principal_point_px=(18.5, 16.5))
)
DISTORTED = default_rig(camera=RIG.camera.model_copy(update={"distortion": (-0.3, 0.1, 0.002, -0.001, 0.0)}))
RIGS = pytest.mark.parametrize("rig", [RIG, DISTORTED], ids=["pinhole", "distorted"])
POSE = (0.5, 0.3, -0.45, 0.2)
MIRROR_POSE = (0.5, 0.0, -0.5, 0.0)


def lobe(m: float) -> ClosedFormMaterial:
    """Return a material with a lobe of RMS slope m."""
    material = parse_material(f"cook-torrance:kd=0.1,ks=0.5,m={m!r},ior=1.5")
    assert isinstance(material, ClosedFormMaterial)
    return material


def light(rig: Rig, material: ClosedFormMaterial, extents: Extents | None = None) -> DirectLight:
    """Return direct light in float64."""
    extents = extents or extents_of(rig)
    nodes = Float64Nodes(closed_form_reflectance(material), extents, rig.sample.diameter_mm / 2.0)
    return DirectLight(rig, nodes, extents)


def traced(mi: Any, rig: Rig, material: ClosedFormMaterial, extents: Extents | None = None) -> DirectLight:
    """Return the same through Mitsuba."""
    extents = extents or extents_of(rig)
    nodes = MitsubaNodes(mi, material, extents, rig.sample.diameter_mm / 2.0)
    return DirectLight(rig, nodes, extents)


def dense(rig: Rig, material: ClosedFormMaterial, pose: tuple[float, ...], pixels: NDArray[np.intp]) -> Any:
    """Mean of f_r E over lamp, pixel and pupil by brute force, written anew from the rig's own geometry.

    9 Gauss points on the pixel's box; 36 nodes on the lamp's disc and as many on the pupil's.
    """
    f_r, frames = closed_form_reflectance(material), Kinematics(rig).frames(pose)
    lamp, lamp_weights = disc_nodes(3)
    pupil, pupil_weights = disc_nodes(3)
    facing = -frames.light_mm / np.linalg.norm(frames.light_mm)
    ring = np.linalg.svd(facing[None])[2][1:]
    radius_mm = rig.lamp.diameter_mm / 2.0
    points, weights = np.polynomial.legendre.leggauss(3)
    total = np.zeros((len(pixels), 3))
    for dv, weight_v in zip(points / 2.0, weights / 2.0, strict=True):
        for du, weight_u in zip(points / 2.0, weights / 2.0, strict=True):
            seen = pixel_geometry(
                rig,
                pose,
                rows=np.arange(rig.camera.height_px) + dv,
                cols=np.arange(rig.camera.width_px) + du,
            )
            place = seen.position_mm.reshape(-1, 2)[pixels]
            p = np.concatenate([place, np.zeros((len(pixels), 1))], axis=1)[:, None, None, :]
            aperture = rig.camera.aperture_diameter_mm / 2.0 * pupil @ frames.camera_rotation[:, :2].T
            # All rays of a point meet in the plane that holds the sample's centre, and not on the sample.
            way = p - frames.camera_mm
            in_focus = rig.camera.distance_mm / (way @ frames.camera_rotation[:, 2])[..., None] * way
            bent = in_focus - aperture
            start = frames.camera_mm + aperture
            p = start - start[:, 2:] / bent[..., 2:] * bent
            to_light = (frames.light_mm + radius_mm * lamp @ ring)[:, None, :] - p
            to_camera = frames.camera_mm + aperture - p
            r = np.linalg.norm(to_light, axis=-1, keepdims=True)
            wi, wo = np.broadcast_arrays(
                to_light / r, to_camera / np.linalg.norm(to_camera, axis=-1)[..., None]
            )
            e = (rig.lamp.distance_mm**2 + radius_mm**2) * wi[..., 2] * -(wi @ facing) / r[..., 0] ** 2
            value = f_r(wi.reshape(-1, 3), wo.reshape(-1, 3)).reshape(*wi.shape) * e[..., None]
            total += weight_u * weight_v * np.einsum("nlpc,l,p->nc", value, lamp_weights, pupil_weights)
    return total


def whole(rig: Rig, pose: tuple[float, ...]) -> NDArray[np.bool_]:
    """Pixels that lie on the sample with all of their box, row by row."""
    found = np.ones(rig.camera.width_px * rig.camera.height_px, dtype=np.bool_)
    for dv in (-0.5, 0.5):
        for du in (-0.5, 0.5):
            rows, cols = np.arange(rig.camera.height_px) + dv, np.arange(rig.camera.width_px) + du
            found &= pixel_geometry(rig, pose, rows=rows, cols=cols).on_sample.ravel()
    return found


def relative_rms(found: NDArray[np.float64], expected: NDArray[np.float64]) -> float:
    """RMS error relative to the mean."""
    return float(np.sqrt(np.mean(np.square(found - expected))) / np.mean(expected))


class TestRules:
    @pytest.mark.parametrize("level", [1, 2, 3])
    def test_degree(self, level: int) -> None:
        """Would catch a node or a weight that is wrong: every part must have its degree, 3, 7, 15."""
        degree = 2 ** (level + 1) - 1
        rule = product_rule(Levels(level, level if level < 3 else 0, 0))
        even = degree - 1
        x, u = rule.nodes[:, 0], rule.nodes[:, 2]
        # Mean of x^n over the unit disc: (n - 1)!!/(n + 2)!! times 2.
        odd_over_even = np.prod([(k - 1.0) / (k + 2.0) for k in range(2, even + 1, 2)])
        assert rule.weights @ x**even == pytest.approx(odd_over_even, rel=1e-12)
        assert rule.weights @ x**degree == pytest.approx(0.0, abs=1e-13)
        if level < 3:
            assert rule.weights @ u**even == pytest.approx(0.5**even / (even + 1), rel=1e-12)

    def test_a_combination_holds_each_surplus_once(self) -> None:
        """Would catch weights of the combination that count a part twice or leave it out."""
        levels = frozenset({CENTRES, Levels(1, 0, 0), Levels(0, 0, 1), Levels(0, 1, 0), Levels(2, 0, 0)})
        rule = sparse_rule(levels)
        assert rule.weights.sum() == pytest.approx(1.0, abs=1e-14)
        assert sum(combination_weight(item, levels) for item in levels) == 1
        # A sum of functions of one part each is exact though no product of parts is in the set.
        lamp, pixel, pupil = rule.nodes[:, 0], rule.nodes[:, 2], rule.nodes[:, 4]
        assert rule.weights @ (lamp**6 + pixel**2 + pupil**2) == pytest.approx(5 / 64 + 1 / 12 + 1 / 4)


class TestShare:
    def test_of_a_cut_square(self) -> None:
        """Would catch a pixel on the sample's edge that holds too much or too little of it."""
        rng = np.random.default_rng(5)
        a, b, reach = np.abs(rng.normal(size=(2, 200))), rng.uniform(0, 1, 200), rng.uniform(-1, 1, 200)
        a, b = a[0], b * a[1]
        u, v = np.meshgrid((np.arange(400) + 0.5) / 400 - 0.5, (np.arange(400) + 0.5) / 400 - 0.5)
        counted = [np.mean(p * u + q * v <= r) for p, q, r in zip(a, b, reach, strict=True)]
        np.testing.assert_allclose(half_plane_share(reach, a, b), counted, atol=3e-3)
        assert half_plane_share(np.zeros(1), np.ones(1), np.zeros(1)) == pytest.approx(0.5)

    def test_the_pixels_hold_the_samples_solid_angle(self) -> None:
        """Would catch a sample that is too large or too small by a part of a pixel."""
        material = parse_material("lambert:kd=1")
        assert isinstance(material, ClosedFormMaterial)
        upright = (0.0, 0.0, 0.0, 0.0)
        radiance = light(RIG, material, Extents(0.0, 1.0, 0.0)).render(upright, 1e-6).radiance
        pixels = pixel_geometry(RIG, upright)
        e = (RIG.lamp.distance_mm / pixels.light_distance_mm) ** 2 * pixels.wi[..., 2]
        area = np.pi * (RIG.camera.focal_length_px * 25.0 / RIG.camera.distance_mm) ** 2
        assert np.sum(np.pi * radiance[..., 0] / e) == pytest.approx(area, rel=1e-4)

    def test_a_pixel_half_on_the_sample_holds_half(self) -> None:
        """Would catch an edge that only pixels' centres decide about."""
        edge_px = RIG.camera.focal_length_px * 25.0 / RIG.camera.distance_mm
        # The edge goes through the middle of column 33.
        camera = RIG.camera.model_copy(update={"principal_point_px": (33.0 - edge_px, 16.0)})
        rig = default_rig(camera=camera)
        radiance = light(rig, lobe(0.5)).render((0.0, 0.0, 0.0, 0.0), 1e-6).radiance[16, :, 0]
        assert radiance[33] == pytest.approx(0.5 * radiance[32], rel=0.02)
        assert radiance[34] == 0.0


class TestFloat64:
    @RIGS
    def test_points_are_the_closed_form(self, rig: Rig) -> None:
        """Would catch a homography, a normalisation or a mask that differs from the rig's geometry."""
        expected = PixelwiseLight(rig, closed_form_reflectance(lobe(0.1))).radiance(POSE)
        found = light(rig, lobe(0.1), POINTS).render(POSE, 1e-3)
        np.testing.assert_allclose(found.radiance, expected, rtol=1e-11 if rig is RIG else 1e-9)
        assert found.error < 1e-12

    def test_a_white_under_the_lamp_has_its_radiance(self) -> None:
        """Would catch a lamp's disc that is not normalised to 1 at the sample's centre."""
        white = parse_material("lambert:kd=1")
        assert isinstance(white, ClosedFormMaterial)
        big = default_rig(
            camera=Camera(width_px=3, height_px=3, focal_length_px=1e5, principal_point_px=(1.0, 1.0)),
            lamp=RIG.lamp.model_copy(update={"diameter_mm": 200.0}),
        )
        found = light(big, white).render((0.0, 0.0, 0.0, 0.0), 1e-9).radiance[1, 1]
        assert np.pi * found == pytest.approx(1.0, abs=1e-9)

    @RIGS
    @pytest.mark.parametrize("m", [0.01, 0.05, 0.3])
    def test_error_is_below_its_estimate(self, rig: Rig, m: float) -> None:
        """Would catch an estimate that trusts itself too much, at any tolerance, in or off the peak."""
        rng = np.random.default_rng(int(1000 * m))
        for tolerance in (1e-2, 1e-3, 1e-4):
            off = rng.normal(0.0, m, 4)
            elevation = rng.uniform(-1.2, 1.2)
            pose = tuple(np.array([elevation, 0.0, -elevation, 0.0]) + off)
            pixels = rng.permutation(np.flatnonzero(whole(rig, pose)))[:60]
            found = light(rig, lobe(m)).render(pose, tolerance)
            expected = dense(rig, lobe(m), pose, pixels)
            assert found.error <= tolerance
            assert relative_rms(found.radiance.reshape(-1, 3)[pixels], expected) <= found.error

    def test_what_does_not_matter_is_skipped(self) -> None:
        """Would catch nodes that a wide lobe does not need, or a part that is left out at any tolerance."""
        coarse, fine = (light(RIG, lobe(0.5)).render(POSE, tolerance) for tolerance in (1e-2, 1e-7))
        assert coarse.did.startswith("1 nodes")
        assert not fine.did.startswith("1 nodes")
        left = relative_rms(coarse.radiance, fine.radiance)
        assert fine.error <= 1e-7 < left <= coarse.error <= 1e-2

    def test_a_narrow_lobe_needs_more(self) -> None:
        """Would catch a search that does not look where the lobe is."""
        nodes = [int(light(RIG, lobe(m)).render(MIRROR_POSE, 1e-4).did.split()[0]) for m in (0.5, 0.05, 0.01)]
        assert nodes == sorted(nodes)
        assert nodes[0] < nodes[2]

    def test_black_and_upside_down(self) -> None:
        """Would catch a division by a mean of zero, or light through the sample."""
        black = parse_material("lambert:kd=0")
        assert isinstance(black, ClosedFormMaterial)
        assert not light(RIG, black).render(POSE, 1e-3).radiance.any()
        below = (2.0, 0.0, -0.4, 0.0)
        assert not light(RIG, lobe(0.3)).render(below, 1e-3).radiance.any()
        assert not light(RIG, lobe(0.3)).render((0.4, 0.0, 2.0, 0.0), 1e-3).radiance.any()


@pytest.mark.render
class TestMitsuba:
    @RIGS
    @pytest.mark.parametrize("extents", [POINTS, None], ids=["points", "sizes"])
    def test_is_float64_in_single_precision(self, vector: Any, rig: Rig, extents: Extents | None) -> None:
        """Would catch a geometry that differs between the two, or rounding beyond what is stated."""
        inside = whole(rig, POSE)
        for m in (0.02, 0.1, 0.5):
            expected = light(rig, lobe(m), extents).render(POSE, 1e-5).radiance.reshape(-1, 3)[inside]
            found = traced(vector, rig, lobe(m), extents).render(POSE, 1e-5)
            difference = relative_rms(found.radiance.reshape(-1, 3)[inside], expected)
            assert difference <= min(found.error, 1e-6 if m >= 0.1 else 3e-5)

    def test_shares_are_the_same(self, vector: Any) -> None:
        """Would catch an edge of the sample that lies elsewhere."""
        expected = light(RIG, lobe(0.3)).render(POSE, 1e-3).radiance
        found = traced(vector, RIG, lobe(0.3)).render(POSE, 1e-3).radiance
        np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-5 * expected.max())

    def test_many_are_as_one_by_one(self, vector: Any, monkeypatch: pytest.MonkeyPatch) -> None:
        """Would catch poses that are mixed up in a launch, or that choose one another's nodes."""
        rng = np.random.default_rng(3)
        poses = [tuple(rng.uniform(-1.0, 1.0, 4)) for _ in range(7)]
        monkeypatch.setattr(direct, "TOGETHER", 3 * RIG.camera.width_px * RIG.camera.height_px)
        evaluator = traced(vector, RIG, lobe(0.05))
        for pose, found in zip(poses, evaluator.render_many(poses, 1e-4), strict=True):
            alone = evaluator.render(pose, 1e-4)
            assert found.did == alone.did
            np.testing.assert_array_equal(found.radiance, alone.radiance)

    def test_no_pose_compiles_anew(self, vector: Any) -> None:
        """Would catch a pose's numbers that are compiled in: 30 ms for every picture."""
        import drjit as dr

        assert vector
        evaluator = traced(vector, RIG, lobe(0.1))
        evaluator.render(POSE, 1e-4)
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            evaluator.render(MIRROR_POSE, 1e-4)
            kernels = [entry for entry in dr.kernel_history() if entry["type"] is dr.KernelType.JIT]
        assert kernels
        assert all(entry["cache_hit"] for entry in kernels)

    def test_rows_of_the_table(self, vector: Any) -> None:
        """Would catch a method that is built for what it cannot do, or that differs from its other half."""
        scene = Scene(RIG, lobe(0.2), frozenset({Event.GLOSSY}))
        paths = LightPaths("LDE")
        float64, mitsuba = DirectFloat64(), DirectMitsuba()
        assert mitsuba.obstacle(scene, paths, vector=False)
        found = []
        for method in (float64, mitsuba):
            assert paths <= method.covers
            assert method.obstacle(scene, paths, vector=True) is None
            assert method.seconds(scene, paths, 1e-2, vector=True) > 0.0
            found.append(method.build(vector, scene, paths).render(POSE, 1e-4).radiance)
        inside = whole(RIG, POSE)
        assert relative_rms(*(image.reshape(-1, 3)[inside] for image in found)) < 1e-6

    def test_materials_of_mitsubas_own(self, vector: Any) -> None:
        """Would catch a BSDF that is asked with its directions or its cosine the wrong way round."""
        own = parse_material("mitsuba:roughconductor,alpha=0.2,material=none")
        scene = Scene(RIG, own, frozenset({Event.GLOSSY}))
        paths = LightPaths("LDE")
        found = [
            method.build(vector, scene, paths).render(POSE, 1e-4).radiance
            for method in (DirectFloat64(), DirectMitsuba())
        ]
        assert found[0].any()
        inside = whole(RIG, POSE)
        assert relative_rms(*(image.reshape(-1, 3)[inside] for image in found)) < 3e-6
