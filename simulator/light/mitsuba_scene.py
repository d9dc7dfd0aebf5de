"""The rig as Mitsuba sees it: a flat sample at the origin, a small lamp, a pinhole, perhaps a housing.

Lengths stay in millimetres. The lamp's intensity is its distance squared, so that the irradiance at the
sample's centre at normal incidence is 1 and a white of albedo rho has a radiance of rho/pi.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from analysis.models import MODELS
from analysis.models.base import Kind
from rig.angles import unit
from rig.kinematics import Kinematics
from rig.pixels import pixel_geometry
from rig.placement import placed_solids
from simulator.bsdfs import MOUNTINGS, PLACED
from simulator.light.mitsuba_meshes import mesh, solid_mesh, spherical_mirror, tube
from simulator.light.scene import Event, SphericalMirror
from simulator.materials import ClosedFormMaterial, MitsubaMaterial, load_bsdf
from simulator.mounting import Form

if TYPE_CHECKING:
    from rig.description import Rig
    from simulator.light.scene import PlanarMirror, Scene
    from simulator.light.solids import SolidSurfaces
    from simulator.materials import Material

Array = NDArray[np.float64]


CLIPPED = 1e-4
"""Of the camera's distance, before which nothing is seen: Mitsuba's own would suit metres."""


def sample_events(mi: Any, material: Material) -> frozenset[Event]:
    """Find out what a material can do to light.

    Parameters
    ----------
    mi : module
        Mitsuba, its variant set and `simulator.bsdfs` registered.
    material : Material
        What is asked about.

    Returns
    -------
    frozenset of Event
        Empty for black.

    Raises
    ------
    BadInput
        Mitsuba refuses the material.
    """
    events = _events(mi, material)
    pattern = material.mounting.pattern
    return events if pattern is None else events | _events(mi, pattern.other)


def _events(mi: Any, material: Material) -> frozenset[Event]:
    if isinstance(material, ClosedFormMaterial):
        scales = [p.name for p in MODELS[material.model].PARAMETERS if p.kind is not Kind.SHAPE]
        if scales and not any(any(material.truth[name]) for name in scales):
            return frozenset()
        return frozenset({Event.LAMBERTIAN if material.model == "lambert" else Event.GLOSSY})
    if not isinstance(material, MitsubaMaterial):
        return frozenset({Event.GLOSSY})
    bsdf, events = load_bsdf(mi, material), set()
    if bsdf.flags() & mi.BSDFFlags.Smooth:
        # Of Mitsuba's own, only this one scatters the same in all directions: a coat bends a base's light.
        plain = material.description["type"] == "diffuse"
        events.add(Event.LAMBERTIAN if plain else Event.GLOSSY)
    if bsdf.flags() & mi.BSDFFlags.Delta:
        events.add(Event.MIRROR)
    return frozenset(events)


def lamp_intensity(rig: Rig) -> float:
    """Radiant intensity of the lamp at level 1, in mm^2 times the unit of irradiance."""
    return rig.lamp.distance_mm**2


def camera_rays(rig: Rig) -> Array:
    """Trace the lens: unit directions of the rays through the pixels' centres, in the camera's frame.

    Parameters
    ----------
    rig : Rig
        Whose camera is meant.

    Returns
    -------
    ndarray, shape (height * width, 3)
        Right, down, forward, row by row; backwards, where nothing is, for a pixel that the lens gives no ray.
    """
    park = np.zeros(len(rig.arm_joints))
    to_sample = -pixel_geometry(rig, park).wo.reshape(-1, 3)
    rays = to_sample @ Kinematics(rig).frames(park).camera_rotation
    return np.where(np.isnan(rays), [0.0, 0.0, -1.0], rays)


def point_lamp(rig: Rig) -> dict[str, Any]:
    """Return the lamp as a point of equal intensity in all directions."""
    return {
        "type": "point",
        "position": [0.0, 0.0, rig.lamp.distance_mm],
        "intensity": {"type": "rgb", "value": lamp_intensity(rig)},
    }


def disc_lamp(mi: Any, rig: Rig) -> dict[str, Any]:
    """Return the lamp as a disc of its diameter that faces the sample, which mirrors can show.

    Its irradiance differs from the point's by the cosine at the disc, 1e-3 at the edge of the sample. A
    sphere's would not, but Mitsuba's single precision samples so small a one with errors of several 1e-3.
    """
    radius_mm = rig.lamp.diameter_mm / 2.0
    radiance = lamp_intensity(rig) / (math.pi * radius_mm**2)
    return {
        "type": "disk",
        "to_world": disc_lamp_placed(mi, rig, np.array([0.0, 0.0, rig.lamp.distance_mm])),
        "emitter": {"type": "area", "radiance": {"type": "rgb", "value": radiance}},
    }


def disc_lamp_placed(mi: Any, rig: Rig, light_mm: Array) -> Any:
    """Return the transformation of the unit disc that puts the lamp at a place, facing the origin."""
    # Any direction that is not the lamp's own will do for "up" of something round.
    up = np.eye(3)[np.argmin(np.abs(light_mm))]
    facing = mi.ScalarTransform4f().look_at(origin=light_mm.tolist(), target=[0.0, 0.0, 0.0], up=up.tolist())
    return facing @ mi.ScalarTransform4f().scale(rig.lamp.diameter_mm / 2.0)


def housing(mi: Any, albedo: float, half_size_mm: float) -> dict[str, Any]:
    """Return a cube around everything, grey inside."""
    return {
        "type": "cube",
        "flip_normals": True,
        "to_world": mi.ScalarTransform4f().scale(half_size_mm),
        "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": albedo}},
    }


def planar_mirror(mi: Any, mirror: PlanarMirror) -> dict[str, Any]:
    """Return a rectangle that mirrors on its bright side and is black behind."""
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1], matrix[:3, 2] = mirror.across_mm, mirror.up_mm, mirror.normal
    matrix[:3, 3] = mirror.centre_mm
    return {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f(matrix.tolist()),
        "bsdf": _ideal_mirror(mirror.reflectance),
    }


def _ideal_mirror(reflectance: float) -> dict[str, Any]:
    value = {"type": "rgb", "value": reflectance}
    return {"type": "conductor", "material": "none", "specular_reflectance": value}


def solids(mi: Any, surfaces: SolidSurfaces) -> dict[str, Any]:
    """Return a machine's solids where they are at zero, by the names `solid0`, `solid1`..."""
    found = {}
    for number, corners in enumerate(surfaces.upright):
        value = {"type": "rgb", "value": float(surfaces.albedos[number])}
        bsdf = mi.load_dict({"type": "diffuse", "reflectance": value})
        found[f"solid{number}"] = mesh(mi, f"solid{number}", bsdf, corners, surfaces.faces(number))
    return found


def near_clip_mm(rig: Rig) -> float:
    """Return how far before the pupil the camera's own solids end that stand around its view."""
    upright = placed_solids(rig, np.zeros(len(rig.arm_joints)))
    kinematics = Kinematics(rig)
    camera = kinematics.frames(np.zeros(len(rig.arm_joints))).camera_mm
    towards = -unit(camera)
    reach = [CLIPPED * rig.camera.distance_mm]
    widest = rig.sample.diameter_mm / 2.0 + rig.camera.aperture_diameter_mm / 2.0
    for solid, description in zip(upright, rig.solids, strict=True):
        if description.link not in rig.arms.camera:
            continue
        corners, _ = solid_mesh(solid.shape, 16, 8)
        way = corners @ solid.pose[:3, :3].T + solid.pose[:3, 3] - camera
        ahead = way @ towards
        beside = np.linalg.norm(way - ahead[:, None] * towards, axis=1)
        if np.any(ahead > 0.0) and np.any(beside[ahead > 0.0] < widest):
            reach.append(1.001 * float(ahead.max()))
    return max(reach)


def mirror(mi: Any, number: int, scene: Scene) -> Any:
    """Return one of a scene's mirrors, or its description."""
    shape = scene.mirrors[number]
    if isinstance(shape, SphericalMirror):
        bsdf = mi.load_dict(_ideal_mirror(shape.reflectance))
        return spherical_mirror(mi, f"mirror{number}", shape, bsdf)
    return planar_mirror(mi, shape)


def sample(mi: Any, scene: Scene) -> Any:
    """Return the sample, or its description: its form, mounted, with its material on it.

    Parameters
    ----------
    mi : module
        Mitsuba, `simulator.bsdfs` registered.
    scene : Scene

    Raises
    ------
    BadInput
        Mitsuba refuses the material.
    """
    mounting, radius_mm = scene.material.mounting, scene.sample_radius_mm
    bsdf = _on_it(mi, scene)
    if mounting.form is Form.CYLINDER:
        return tube(mi, mounting, radius_mm, bsdf)
    placed = mounting.to_scene
    shape = np.eye(4)
    if mounting.form is Form.SPHERE:
        shape[:3, :3] *= mounting.radius_mm
        shape[2, 3] = -mounting.radius_mm
    else:
        shape[:2, :2] *= radius_mm
    # What reaches beyond the sample's disc is black.
    return {
        "type": "disk" if mounting.form is Form.FLAT else "sphere",
        "to_world": mi.ScalarTransform4f((placed @ shape).tolist()),
        "bsdf": bsdf,
    }


def _on_it(mi: Any, scene: Scene) -> Any:
    """Return the sample's BSDF, with axes, relief, edge and pattern where it needs them."""
    bsdf, mounting = load_bsdf(mi, scene.material), scene.material.mounting
    if isinstance(scene.material, MitsubaMaterial):
        grained = bool(bsdf.flags() & mi.BSDFFlags.Anisotropic)
    else:
        grained = not scene.material.isotropic
    if scene.plain and not grained:
        return bsdf
    key = repr(mounting)
    MOUNTINGS[key] = mounting
    description = {"type": PLACED, "of": bsdf, "mounting": key}
    if mounting.pattern is not None:
        description["other"] = load_bsdf(mi, mounting.pattern.other)
    return mi.load_dict(description | {"radius": scene.sample_radius_mm})


def camera_placed(mi: Any, camera_mm: Array, camera_rotation: Array) -> Any:
    """Return the camera's transformation; Mitsuba's camera has +x to the left, +y up and looks along +z."""
    right, down, forward = camera_rotation.T
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1], matrix[:3, 2], matrix[:3, 3] = -right, -down, forward, camera_mm
    return mi.ScalarTransform4f(matrix.tolist())


def perspective_camera(mi: Any, rig: Rig, samples_per_pixel: int) -> dict[str, Any]:
    """Return the rig's pinhole, without distortion, which Mitsuba's cannot have."""
    camera = rig.camera
    width, height = camera.width_px, camera.height_px
    overview_mm = 4.0 * (camera.distance_mm + rig.lamp.distance_mm)
    return {
        "type": "perspective",
        "fov_axis": "x",
        "fov": math.degrees(2.0 * math.atan2(width / 2.0, camera.focal_length_px)),
        "principal_point_offset_x": 0.5 - (camera.principal_point_px[0] + 0.5) / width,
        "principal_point_offset_y": 0.5 - (camera.principal_point_px[1] + 0.5) / height,
        # Mitsuba's own far clip would render a large rig black without a word.
        "near_clip": CLIPPED * camera.distance_mm,
        "far_clip": 10.0 * overview_mm,
        "to_world": camera_placed(mi, np.array([0.0, 0.0, camera.distance_mm]), np.diag([1.0, -1.0, -1.0])),
        "sampler": {"type": "independent", "sample_count": samples_per_pixel},
        "film": {
            "type": "hdrfilm",
            "width": width,
            "height": height,
            "pixel_format": "rgb",
            "component_format": "float32",
            "rfilter": {"type": "box"},
        },
    }
