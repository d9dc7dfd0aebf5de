"""Shared errors: what n samples with one error in common cost a fit."""

from __future__ import annotations

import numpy as np
import pytest

from analysis import uncertainty
from analysis.models import MODELS
from analysis.samples import make_samples
from analysis.uncertainty import SharedError, meat
from rig.angles import rotation, spherical_to_direction

COUNT = 12


def samples(**columns):
    """Return samples along an arc, with uncertainty columns."""
    theta = np.linspace(0.1, 1.2, COUNT)
    wi, wo = (
        spherical_to_direction(theta, np.zeros(COUNT)),
        spherical_to_direction(theta[::-1], np.full(COUNT, 2.5)),
    )
    return make_samples(wi, wo, np.ones((COUNT, 2)), **columns)


def test_the_filling_is_the_covariance_of_the_gradient():
    """Catches an error counted as independent that is shared, or the other way round: drawn errors decide."""
    random = np.random.default_rng(4)
    scores = random.standard_normal((COUNT, 2, 3))
    own = random.random((COUNT, 2))
    groups = np.repeat([0, 1, 2], 4)
    white = SharedError("white", random.random((COUNT, 2)), groups, across_channels=False)
    pose = SharedError("joint", random.standard_normal((COUNT, 2)), groups, across_channels=True)
    draws = 40_000
    errors = own * random.standard_normal((draws, COUNT, 2))
    errors += white.column * random.standard_normal((draws, 3, 2))[:, groups]
    errors += pose.column * random.standard_normal((draws, 3, 1))[:, groups]
    gradients = np.einsum("dnc,ncp->dp", errors, scores)
    ours, drawn = meat(scores, own, [white, pose]), np.cov(gradients.T)
    scale = np.sqrt(np.outer(np.diag(ours), np.diag(ours)))
    np.testing.assert_allclose(drawn / scale, ours / scale, atol=0.03)


def test_columns_go_to_those_who_share_them():
    """Catches a reference error that averages out over samples, and columns counted again in u_f_r."""
    full = samples(u_noise=0.1, u_binning=0.2, u_white=0.3, white_group=np.repeat([5, 7], 6), u_reference=0.4)
    np.testing.assert_allclose(uncertainty.independent(full), np.sqrt(0.05))
    white, reference = uncertainty.shared_in_f(full)
    assert (white.across_channels, reference.across_channels) == (False, True)
    assert white.group.tolist() == [0] * 6 + [1] * 6
    assert set(reference.group) == {0}
    only_total = samples(u_f_r=0.5)
    np.testing.assert_array_equal(uncertainty.independent(only_total), 0.5)
    assert uncertainty.shared_in_f(only_total) == []
    assert uncertainty.has_uncertainty(full)
    assert not uncertainty.has_uncertainty(samples())


def test_a_white_without_groups_is_shared_by_all():
    """Catches the optimistic reading of a missing `white_group`."""
    (white,) = uncertainty.shared_in_f(samples(u_noise=0.1, u_white=0.3))
    assert set(white.group) == {0}


def test_pose_errors_follow_the_model():
    """Catches a wrong sign or scale of d_wi, d_wo: turning both about the normal changes nothing."""
    plain = samples(u_noise=0.1)
    axis = np.array([0.0, 0.0, 1.0])
    turn_i, turn_o = np.cross(axis, plain["wi"].to_numpy()), np.cross(axis, plain["wo"].to_numpy())
    model = MODELS["cook-torrance"](kd=[0.1, 0.2], ks=0.5, m=0.3, ior=1.5)
    both = samples(
        u_noise=0.1,
        pose=np.arange(COUNT),
        d_wi=np.stack([turn_i, np.zeros_like(turn_i)], axis=1),
        d_wo=np.stack([turn_o, turn_o], axis=1),
        u_joint_rad=[1e-3, 2e-3],
    )
    together, alone = uncertainty.shared_by_pose(both, model)
    np.testing.assert_allclose(together.column, 0.0, atol=1e-9)
    small = 1e-6
    turned = plain["wo"].to_numpy() @ rotation(axis, small).T
    change = model.evaluate(plain["wi"], turned) - model.evaluate(plain["wi"], plain["wo"])
    np.testing.assert_allclose(alone.column, 2e-3 * change / small, rtol=1e-3, atol=1e-9)
    assert uncertainty.shared_by_pose(plain, model) == []


def test_quadrature():
    """Catches standard uncertainties that are added."""
    assert uncertainty.quadrature(np.array(3.0), np.array(4.0)) == pytest.approx(5.0)
