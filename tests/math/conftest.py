"""The array libraries and precisions that every law of the rotation code is checked in."""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np
import pytest

LIBRARIES = ("numpy", "torch")  # JAX compiles every single operation: test_libraries.py compares it, compiled whole


@dataclass(frozen=True)
class Library:
    """One array library at one precision."""

    name: str
    module: ModuleType
    dtype: str

    @property
    def eps(self) -> float:
        return float(np.finfo(self.dtype).eps)

    def array(self, values: Any) -> Any:
        values = np.asarray(values, self.dtype)
        if self.name == "numpy":
            return values
        return self.module.asarray(values.copy())

    def numpy(self, array: Any) -> np.ndarray:
        """Back to NumPy, after checking that neither the library nor the precision was left."""
        home = (np.ndarray, np.generic) if self.name == "numpy" else self.module.Tensor
        assert isinstance(array, home), type(array)
        assert str(array.dtype).removeprefix("torch.") == self.dtype, array.dtype
        return np.array(
            array if self.name == "numpy" else array.detach().numpy()
        )  # a copy: SciPy wants writable arrays


@pytest.fixture(params=[f"{name}-{dtype}" for name in LIBRARIES for dtype in ("float64", "float32")])
def library(request: pytest.FixtureRequest) -> Library:
    name, dtype = request.param.split("-")
    module = pytest.importorskip(name, reason=f"{name} is not installed")
    return Library(name, module, dtype)


@pytest.fixture
def torch() -> ModuleType:
    """PyTorch in float64, for gradients."""
    return pytest.importorskip("torch", reason="torch is not installed")


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20240607)
