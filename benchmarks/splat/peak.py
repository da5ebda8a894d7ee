"""The machine's float32 limit: fused multiply-adds on 16-lane vectors that stay in registers."""

from __future__ import annotations

import threading
import time

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

LANES, CHAINS, STEPS = 16, 12, 20_000_000  # enough chains to hide the latency of a multiply-add on two units


@intrinsic
def _chains(typing, steps, start):
    """Run `steps` rounds of CHAINS independent multiply-adds and return a number that depends on all of them."""

    def generate(context, b, signature, arguments):
        vector = ir.VectorType(ir.FloatType(), LANES)
        fma = cgutils.get_or_insert_function(b.module, ir.FunctionType(vector, [vector] * 3), "llvm.fma.v16f32")
        undefined, zeros = ir.Constant(vector, ir.Undefined), ir.Constant(ir.VectorType(ir.IntType(32), LANES), None)
        first = b.insert_element(undefined, arguments[1], ir.Constant(ir.IntType(32), 0))
        value = b.shuffle_vector(first, undefined, zeros)
        slots = [cgutils.alloca_once_value(b, value) for _ in range(CHAINS)]
        with cgutils.for_range(b, arguments[0]):
            for slot in slots:
                b.store(b.call(fma, [b.load(slot), value, value]), slot)
        total = b.load(slots[0])
        for slot in slots[1:]:
            total = b.fadd(total, b.load(slot))
        return b.extract_element(total, ir.Constant(ir.IntType(32), 0))

    return types.float32(types.int64, types.float32), generate


@numba.njit(nogil=True)
def _run(steps, start):
    return _chains(steps, start)


def peak_gflops(threads: int, repeats: int = 5) -> float:
    """Best of `repeats`: float32 operations per second of all threads together, in GFLOP/s."""
    _run(np.int64(10), np.float32(0.5))
    best = 0.0
    for _ in range(repeats):
        ready = threading.Barrier(threads + 1)

        def work(ready: threading.Barrier = ready) -> None:
            ready.wait()
            _run(np.int64(STEPS), np.float32(0.5))

        workers = [threading.Thread(target=work) for _ in range(threads)]
        for worker in workers:
            worker.start()
        start = time.perf_counter()
        ready.wait()
        for worker in workers:
            worker.join()
        best = max(best, threads * STEPS * CHAINS * LANES * 2 / (time.perf_counter() - start) / 1e9)
    return best
