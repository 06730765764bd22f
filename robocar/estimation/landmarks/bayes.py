"""The exact Bayes filter over finitely many states (thesis, eq. 2.17-2.33; Thrun, Burgard and Fox 2005, Table 4.1)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from robocar.core import Array, ParameterError, frozen_array


class DiscreteBayesFilter:
    """Belief over n states.

    Args:
        prior: probabilities (n,), sum 1.

    Raises:
        ParameterError: negative numbers, or a sum that is not 1.
    """

    def __init__(self, prior: ArrayLike) -> None:
        self._belief = _distribution(prior, "the prior")

    @property
    def belief(self) -> Array:
        """Probabilities of the states, (n,)."""
        return self._belief

    def predict(self, transition: ArrayLike) -> Array:
        """An action: bel'(x) = sum over x0 of p(x | u, x0) bel(x0).

        Args:
            transition: p(x | u, x0) in row x, column x0, (n, n); its columns sum to 1.

        Returns:
            The new belief (n,).
        """
        matrix = np.asarray(transition, dtype=float)
        n = len(self._belief)
        if matrix.shape != (n, n):
            raise ParameterError(f"a transition among {n} states needs shape ({n}, {n}), not {matrix.shape}")
        for k in range(n):
            _distribution(matrix[:, k], f"column {k} of the transition")
        self._belief = frozen_array(matrix @ self._belief)
        return self._belief

    def update(self, likelihood: ArrayLike) -> Array:
        """A measurement: bel(x) = eta p(z | x) bel'(x).

        Args:
            likelihood: p(z | x), (n,), from 0 on.

        Returns:
            The new belief (n,).

        Raises:
            ParameterError: no state that is believed in explains the measurement.
        """
        values = np.asarray(likelihood, dtype=float)
        if values.shape != self._belief.shape or not np.all(np.isfinite(values) & (values >= 0)):
            raise ParameterError(f"a likelihood needs {len(self._belief)} finite numbers from 0 on, not {likelihood!r}")
        product = values * self._belief
        total = float(product.sum())
        if not total > 0:
            raise ParameterError("no state that is believed in explains the measurement")
        self._belief = frozen_array(product / total)
        return self._belief


def _distribution(values: ArrayLike, what: str) -> Array:
    array = np.asarray(values, dtype=float)
    if array.ndim != 1 or array.size == 0 or not np.all(array >= 0) or abs(float(array.sum()) - 1.0) > 1e-9:
        raise ParameterError(f"{what} needs probabilities that sum to 1, not {values!r}")
    return frozen_array(array)
