"""Directions drawn about where a material sends light, with their exact density.

Half of them follow the cosine, so that no direction is missed; the rest go to the facets that stand for the
lobes, in equal parts, by their visible normals (Heitz & d'Eon 2014), which Mitsuba has.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import drjit as dr

from simulator.bsdfs.facets import turned

if TYPE_CHECKING:
    from simulator.bsdfs.catalogue import Spread

COSINE_SHARE = 0.5
"""Of a material with lobes; without, all directions follow the cosine."""


class Mixture:
    """A cosine and some `Spread`s.

    Parameters
    ----------
    mi : module
        Mitsuba, its variant set.
    spreads : tuple of Spread
        One for each lobe.
    """

    def __init__(self, mi: Any, spreads: tuple[Spread, ...]) -> None:
        self._mi = mi
        self._facets = [_Facets(mi, spread) for spread in spreads]
        self._cosine = COSINE_SHARE if spreads else 1.0
        self._each = (1.0 - self._cosine) / max(1, len(spreads))

    def sample(self, camera: Any, choice: Any, point: Any) -> Any:
        """Draw a direction to the light; it may lie below the horizon, where its density is zero.

        Parameters
        ----------
        camera : mitsuba.Vector3f
            Direction to the camera.
        choice : number
            Evenly distributed in [0, 1): which part is drawn from.
        point : mitsuba.Point2f
            Evenly distributed in the unit square.
        """
        seen = _above(self._mi, camera)
        light = self._mi.warp.square_to_cosine_hemisphere(point)
        for index, facets in enumerate(self._facets):
            chosen = choice >= self._cosine + index * self._each
            light = dr.select(chosen, facets.sample(seen, point), light)
        return light

    def density(self, camera: Any, light: Any, active: Any) -> Any:
        """Density of a direction to the light, in 1/sr; arguments as in `sample`."""
        lit = (camera.z > 0.0) & (light.z > 0.0) & active
        seen = _above(self._mi, camera)
        safe = dr.select(lit, light, self._mi.Vector3f(0.0, 0.0, 1.0))
        density = self._cosine * self._mi.warp.square_to_cosine_hemisphere_pdf(safe)
        for facets in self._facets:
            density += self._each * facets.density(seen, safe)
        return dr.select(lit, density, 0.0)


def _above(mi: Any, direction: Any) -> Any:
    return dr.select(direction.z > 0.0, direction, mi.Vector3f(0.0, 0.0, 1.0))


class _Facets:
    """GGX facets, their axis turned into the frame's."""

    def __init__(self, mi: Any, spread: Spread) -> None:
        self._mi = mi
        # Channels may differ, a direction serves all of them.
        widths = (dr.mean(mi.Color3f(width)) for width in (spread.along, spread.across))
        self._normals = mi.MicrofacetDistribution(mi.MicrofacetType.GGX, *widths, True)
        self._axis = dr.mean(mi.Color3f(spread.axis_rad))
        self._sign = -1.0 if spread.back else 1.0

    def _turned(self, direction: Any, axis: Any, sign: float = 1.0) -> Any:
        x, y = turned(sign * direction.x, sign * direction.y, axis)
        return self._mi.Vector3f(x, y, direction.z)

    def sample(self, camera: Any, point: Any) -> Any:
        seen = self._turned(camera, self._axis, self._sign)
        normal, _ = self._normals.sample(seen, point)
        return self._turned(2.0 * dr.dot(seen, normal) * normal - seen, -self._axis)

    def density(self, camera: Any, light: Any) -> Any:
        seen = self._turned(camera, self._axis, self._sign)
        normal = dr.normalize(seen + self._turned(light, self._axis))
        return self._normals.pdf(seen, normal) / (4.0 * dr.dot(seen, normal))
