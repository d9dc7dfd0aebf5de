"""The table of methods that the choice goes through."""

from __future__ import annotations

from typing import TYPE_CHECKING

from simulator.light.direct import DirectFloat64, DirectMitsuba
from simulator.light.path_classes import PathClassesMethod
from simulator.light.path_tracer import PathTracing
from simulator.light.photon_map import PhotonMapMethod
from simulator.light.pixel_centres import PixelCentres
from simulator.light.pixelwise import ClosedForm, PixelByPixel
from simulator.light.radiosity import RadiosityMethod
from simulator.light.surface_light import SurfaceMethod
from simulator.light.virtual_lights import VirtualLightsMethod

if TYPE_CHECKING:
    from simulator.light.evaluator import Method

METHODS: tuple[Method, ...] = (
    ClosedForm(),
    PixelCentres(),
    PixelByPixel(),
    DirectMitsuba(),
    DirectFloat64(),
    SurfaceMethod(),
    VirtualLightsMethod(),
    PhotonMapMethod(),
    RadiosityMethod(),
    PathTracing(),
    PathClassesMethod(),
)
"""Every method; the order decides only between equals."""
