"""Pictures survive, as OpenCV reads them."""

import cv2
import numpy as np
import pytest

from luxloop.loop.rig.wire.png import png


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_numbers_come_as_they_are(dtype: type) -> None:
    image = np.random.default_rng(0).integers(0, np.iinfo(dtype).max, (301, 257), dtype, endpoint=True)  # more than a block of 64 KiB
    read = cv2.imdecode(np.frombuffer(png(image), np.uint8), cv2.IMREAD_UNCHANGED)
    assert read.dtype == dtype and (read == image).all()
