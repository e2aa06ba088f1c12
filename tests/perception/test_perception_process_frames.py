"""The memory that images cross in."""

from __future__ import annotations

import errno
import os

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge.perception.process import frames
from edge.perception.process.frames import FrameFile, FrameView


def image(height, width, seed=0):
    return np.random.default_rng(seed).integers(0, 256, (height, width, 3), np.uint8)


@pytest.fixture
def pair():
    file = FrameFile()
    yield file, FrameView(file.fd)
    file.close()


def test_nothing_was_written(pair):
    _, view = pair
    with pytest.raises(ValueError, match="0 bytes, 67 are needed"):
        view.read(1, (1, 1))


@given(st.lists(st.tuples(st.integers(1, 40), st.integers(1, 40)), min_size=1, max_size=6))
def test_images_of_any_size_arrive(sizes):
    file = FrameFile()
    view = FrameView(file.fd)
    for seq, hw in enumerate(sizes, start=1):
        rgb = image(*hw, seq)
        file.write(seq, rgb)
        np.testing.assert_array_equal(view.read(seq, hw), rgb)
        assert view.is_whole(seq)
    file.close()


def test_a_larger_image_than_the_memory_that_was_mapped(pair):
    file, view = pair
    file.write(1, image(2, 2))
    view.read(1, (2, 2))
    rgb = image(400, 600)
    file.write(2, rgb)
    np.testing.assert_array_equal(view.read(2, (400, 600)), rgb)


def test_what_is_looked_at_is_not_copied(pair):
    file, view = pair
    file.write(1, image(4, 4))
    seen = view.read(1, (4, 4))
    file.write(2, np.full((4, 4, 3), 9, np.uint8))
    assert (seen == 9).all()
    assert not view.is_whole(1)


@pytest.mark.parametrize("half", [frames._BEFORE, frames._AFTER], ids=["begun", "not ended"])
def test_a_torn_image_is_refused(pair, half):
    file, view = pair
    file.write(1, image(4, 4))
    file._seq[half] = 2
    seq = 1 if half == frames._BEFORE else 2
    with pytest.raises(ValueError, match=f"frame {seq}: torn"):
        view.read(seq, (4, 4))


def test_the_file_has_no_name_that_could_be_left_behind(pair):
    file, _ = pair
    file.write(1, image(4, 4))
    assert os.fstat(file.fd).st_nlink == 0
    assert os.fstat(file.fd).st_mode & 0o077 == 0


def test_memory_that_is_not_there_is_an_error_and_no_signal(pair, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    file, view = pair
    file.write(1, image(4, 4))
    monkeypatch.setattr(os, "posix_fallocate", full)
    with pytest.raises(OSError, match="No space left"):
        file.write(2, image(8, 8))
    view.read(1, (4, 4))


def test_without_shared_memory_the_folder_for_temporary_files_serves(monkeypatch, tmp_path):
    monkeypatch.setattr(frames, "SHARED_MEMORY", tmp_path / "none")
    monkeypatch.setattr(frames.tempfile, "tempdir", str(tmp_path))
    assert frames.shared_dir() == str(tmp_path)
