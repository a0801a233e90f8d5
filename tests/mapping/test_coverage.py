"""What is covered of a plane, as polygons."""

import numpy as np
import shapely
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from scipy import ndimage

from mapping.coverage import Coverage, PlaneFrame

MASKS = arrays(np.bool_, array_shapes(min_dims=2, max_dims=2, max_side=12), elements=st.booleans()).filter(np.any)


@given(mask=MASKS)
def test_borders_hold_the_cells_that_a_closing_covers_and_no_others(mask):
    covered = Coverage(PlaneFrame.about(np.zeros(3), np.array([0.0, 0.0, 1.0])), 1.0)
    covered.add(np.pad(np.argwhere(mask) + 0.5, ((0, 0), (0, 1))))
    closed = ndimage.binary_closing(np.pad(mask, 3), np.ones((3, 3)))

    shape = covered.shape(least_m2=0.0, tolerance_m=0.0)

    assert shape.is_valid
    assert np.isclose(shape.area, np.count_nonzero(closed))
    cells = np.argwhere(closed) - 3 + 0.5
    assert shapely.contains_xy(shape, *cells.T).all()


@given(masks=st.lists(MASKS, min_size=2, max_size=5), data=st.data())
def test_samples_that_are_taken_away_leave_what_was_there_before(masks, data):
    def samples(mask):
        offset = np.array(data.draw(st.tuples(st.integers(-20, 20), st.integers(-20, 20))))
        return np.pad(np.argwhere(mask) + 0.5 + offset, ((0, 0), (0, 1)))

    first, *later = map(samples, masks)
    covered = Coverage(PlaneFrame.about(np.zeros(3), np.array([0.0, 0.0, 1.0])), 1.0)
    covered.add(first)
    before = covered.n_covered, covered.extent().tolist(), covered.shape(0.0, 0.0)
    for points in later:
        covered.add(points)
    for points in data.draw(st.permutations(later)):
        covered.remove(points)
    assert (covered.n_covered, covered.extent().tolist()) == before[:2]
    assert covered.shape(0.0, 0.0).equals(before[2])
