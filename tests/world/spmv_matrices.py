"""Random sparse matrices for the tests."""

import numpy as np
import scipy.sparse as sp
from hypothesis import strategies as st


def random_matrix(seed: int, rows: int, cols: int, density: float) -> sp.csr_array:
    """Some rows are left empty, some entries are stored zeros."""
    generator = np.random.default_rng(seed)
    matrix = sp.random_array((rows, cols), density=density, format="csr", rng=generator)
    matrix.data[generator.random(matrix.nnz) < 0.1] = 0
    return matrix


matrices = st.builds(random_matrix, st.integers(0, 2**32), st.integers(1, 30), st.integers(1, 30), st.floats(0, 0.5))
