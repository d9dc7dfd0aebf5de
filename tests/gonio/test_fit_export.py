"""`gonio fit --export`: would catch a file of another fit than the printed one, and an error not told."""

from __future__ import annotations

import json

import numpy as np

from analysis.models import MODELS
from analysis.samples import make_samples, write
from gonio.cli import main
from rig.angles import spherical_to_direction


def test_the_best_fit_goes_out(tmp_path, capsys):
    """Catches names refused after the work, and an export without its error."""
    theta, phi = np.meshgrid(np.radians(np.arange(0.0, 71.0, 7.0)), np.radians(np.arange(0.0, 360.0, 30.0)))
    wo = spherical_to_direction(theta.ravel(), phi.ravel())
    wi = np.repeat(spherical_to_direction(np.radians([5.0, 40.0]), 0.0), len(wo), axis=0)
    wo = np.tile(wo, (2, 1))
    model = MODELS["lambert"](kd=0.4)
    file = str(tmp_path / "white.csv")
    write(make_samples(wi, wo, model.evaluate(wi, wo)), file)
    out = tmp_path / "white.json"
    assert main(["fit", file, "--model", "lambert", "--export", str(out)]) == 0
    assert "the same formula" in capsys.readouterr().err
    bsdf = json.loads(out.read_text())
    np.testing.assert_allclose(bsdf["reflectance"]["value"], [0.4] * 3, rtol=1e-6)
    assert main(["fit", "nowhere.csv", "--export", str(tmp_path / "a.obj")]) == 2
    assert "no fit is exported" in capsys.readouterr().err
    assert main(["fit", file, file, "--export", str(out)]) == 2
    assert "name one file" in capsys.readouterr().err
