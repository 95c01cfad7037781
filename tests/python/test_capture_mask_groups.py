"""Superpixels of the object at several scales."""

import numpy as np

from gaussian_example import camera
from mphygs.capture.mask_groups import Superpixels
from mphygs.capture.views import Photograph


def test_superpixels_keep_to_the_object_and_to_its_borders() -> None:
    height, width = 40, 60
    colour = np.zeros((height, width, 3), dtype=np.float32)
    colour[:, :30], colour[:, 30:] = [0.9, 0.1, 0.1], [0.1, 0.7, 0.2]
    colour += 0.02 * np.random.default_rng(0).standard_normal(colour.shape).astype(np.float32)
    mask = np.zeros((height, width), dtype=np.float32)
    mask[8:32, 10:50] = 1.0
    found = Superpixels(scales=(5.0, 400.0)).groups_of(Photograph(camera(width, height), colour, mask))
    assert len(found) == 2
    for groups in found:
        assert ((groups >= 0) == (mask > 0)).all()
        assert set(np.unique(groups)) == set(range(-1, groups.max() + 1))
    coarse = found[-1]
    left, right = coarse[12:28, 12:27], coarse[12:28, 33:48]
    # one group each, but for the pixels that smoothing mixed at the border
    assert len(np.unique(left)) == 1 and len(np.unique(right)) == 1 and left[0, 0] != right[0, 0]
