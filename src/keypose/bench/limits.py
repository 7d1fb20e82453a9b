# pyright: basic
"""What this machine can do at best, measured with the same vectors as the kernels."""

from __future__ import annotations

from keypose.bench.suite import Suite
from keypose.kernels.runtime import WIDTH, aligned, kernel
from keypose.kernels.vectors import fill, load, store

_SIZES = {"L2": 512 << 10, "L3": 16 << 20, "RAM": 256 << 20}  # bytes
_ROUNDS, _CHAINS = 20000, 12


def add(suite: Suite) -> None:
    """Rows for reading and storing memory of three sizes, and for multiply-adds."""
    out = aligned(WIDTH)
    for name, size in _SIZES.items():
        data = aligned(size // 4)
        data[:] = 1  # touch every page
        label = f"{size / 2**20:g} MB ({name})"
        suite.case(f"limit: read {label}", "GB/s", size, lambda data=data: _read(data, out))
        suite.case(f"limit: store {label}", "GB/s", size, lambda data=data: _store(data, 1.5))
    operations = _ROUNDS * _CHAINS * WIDTH * 2
    suite.case("limit: multiply-add", "Gflop/s", operations, lambda: _multiply_add(_ROUNDS, 0.5, out))


@kernel
def _read(data, out):
    """The sum of an array; eight sums, so that no addition waits for the one before."""
    a = b = c = d = e = f = g = h = fill(data, 0.0)
    for i in range(0, data.shape[0], 8 * WIDTH):
        a, b = a + load(data, i), b + load(data, i + WIDTH)
        c, d = c + load(data, i + 2 * WIDTH), d + load(data, i + 3 * WIDTH)
        e, f = e + load(data, i + 4 * WIDTH), f + load(data, i + 5 * WIDTH)
        g, h = g + load(data, i + 6 * WIDTH), h + load(data, i + 7 * WIDTH)
    store(out, 0, (a + b) + (c + d) + ((e + f) + (g + h)))


@kernel
def _store(data, number):
    v = fill(data, number)
    for i in range(0, data.shape[0], 4 * WIDTH):
        store(data, i, v)
        store(data, i + WIDTH, v)
        store(data, i + 2 * WIDTH, v)
        store(data, i + 3 * WIDTH, v)


@kernel
def _multiply_add(rounds, factor, out):
    """Twelve chains that do not wait for each other; different starts, or the compiler makes one of them."""
    k = fill(out, factor)
    a, b, c, d = fill(out, 1.0), fill(out, 2.0), fill(out, 3.0), fill(out, 4.0)
    e, f, g, h = fill(out, 5.0), fill(out, 6.0), fill(out, 7.0), fill(out, 8.0)
    i, j, m, n = fill(out, 9.0), fill(out, 10.0), fill(out, 11.0), fill(out, 12.0)
    for _ in range(rounds):
        a, b, c, d = a * k + k, b * k + k, c * k + k, d * k + k
        e, f, g, h = e * k + k, f * k + k, g * k + k, h * k + k
        i, j, m, n = i * k + k, j * k + k, m * k + k, n * k + k
    store(out, 0, (a + b + c) + (d + e + f) + (g + h + i) + (j + m + n))
