"""Whether stated intervals hold over sessions whose frames are rendered."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.imaging_sessions import HIGH, LOW, Session, line_of, study
from simulator.materials import parse_material


@pytest.mark.render
def test_rendered_sessions_are_covered() -> None:
    """Would catch an error on the way to samples that no uncertainty speaks of, or one far too large."""
    coverage, error = study(40)
    assert LOW - 2.0 * error <= coverage <= HIGH


@pytest.mark.render
def test_the_twin_shows_the_material_of_the_truth() -> None:
    """Would catch a study of one material against the numbers of another."""
    session = Session(5)
    shown = parse_material(line_of(session.material))
    assert shown.spec.startswith(session.material.NAME)
    for name, values in dict(shown.truth).items():
        np.testing.assert_allclose(values, getattr(session.material, name), rtol=1e-12)
