"""The checksum behind HDF5's end: what it finds, and what it leaves alone."""

from __future__ import annotations

import subprocess

import h5netcdf
import h5py
import numpy as np
import pytest
import xarray as xr

from analysis.formats import hdf5, netcdf
from analysis.samples import make_samples, read, write
from rig.angles import spherical_to_direction
from rig.errors import BadInput


@pytest.fixture
def stored(tmp_path):
    """Return a file of 40 samples and the samples."""
    wi, wo = (
        spherical_to_direction(np.linspace(0, 1, 40), 0.3),
        spherical_to_direction(np.linspace(1, 0, 40), 2.0),
    )
    samples = make_samples(wi, wo, np.linspace(0.1, 0.2, 40), u_noise=0.01)
    path = tmp_path / "samples.nc"
    write(samples, path)
    return path, samples


def test_any_changed_bit_is_found_before_hdf5_sees_it(stored, monkeypatch):
    """Catches a checksum that does not cover all: a wrong value is as bad as a hang."""
    path, _ = stored
    content = path.read_bytes()
    monkeypatch.setattr(h5netcdf, "File", None)  # whoever opens it fails
    for place in range(len(netcdf.MAGIC), len(content) - hdf5.SEAL_BYTES, 97):
        changed = bytearray(content)
        changed[place] ^= 4
        path.write_bytes(changed)
        with pytest.raises(BadInput, match="checksum"):
            read(path)


def test_a_file_without_it_is_read(stored):
    """Catches files of an older gonio or another program refused for what they cannot have."""
    path, samples = stored
    path.write_bytes(path.read_bytes()[: -hdf5.SEAL_BYTES])
    assert read(path).equals(samples)


def test_other_programs_do_not_see_it(stored):
    """Catches a file that only gonio opens, and one that gonio refuses after another program changed it."""
    path, samples = stored
    with xr.open_dataset(path, engine="h5netcdf") as opened:
        np.testing.assert_array_equal(opened["f_r"], samples["f_r"])
    with h5py.File(path, "r+") as file:
        file["f_r"][3] = 0.5
    assert float(read(path)["f_r"][3, 0]) == 0.5


def test_a_search_without_end_is_ended(stored, monkeypatch):
    """Catches a wait for ever on a file that HDF5 hangs on; here a process that sleeps stands for it."""
    path, _ = stored
    path.write_bytes(path.read_bytes()[: -hdf5.SEAL_BYTES])
    start = subprocess.Popen

    def sleeping(command, **options):
        code = f"import time; print('{hdf5.READY}', flush=True); time.sleep(60)"
        return start([command[0], "-c", code], **options)

    monkeypatch.setattr(hdf5.subprocess, "Popen", sleeping)
    monkeypatch.setattr(hdf5, "SEARCH_S", 0.1)
    with pytest.raises(BadInput, match="without end"):
        read(path)
