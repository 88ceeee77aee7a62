"""The GPU sort against numpy's stable argsort and the CPU's sort thread, in turn in one process.

    python tools/bench/bench_sort.py [--counts N ...] [--repeats R] [--tunings]

`--tunings` also times other ways to deal out the work, which is how sort.py chose its own.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from harness import in_turn, make_parser

from splatview.measure.machine import write_results
from splatview.raster import Workspace
from splatview.raster.sort import keyed_values, radix_sort
from splatview.renderers.gl.context import create_headless_context, describe
from splatview.renderers.gl.sort import HARDWARE, SOFTWARE, RadixSort, SortTuning

OTHER_TUNINGS = [
    *(SortTuning(digit_bits=bits, workgroup=8, keys_per_invocation=1024) for bits in (4, 8)),
    *(SortTuning(digit_bits=8, workgroup=size, keys_per_invocation=4096 // size) for size in (4, 16)),
    *(SortTuning(digit_bits=8, workgroup=8, keys_per_invocation=keys) for keys in (256, 2048)),
    HARDWARE,
]


def name_of(tuning: SortTuning) -> str:
    return f"GPU, {tuning.digit_bits} bits, {tuning.workgroup} x {tuning.keys_per_invocation}"


def compare(ctx, count: int, repeats: int, tunings: list[SortTuning]) -> dict[str, Any]:
    """Median, least and greatest milliseconds of each sort of the same random keys with their indices."""
    keys = np.random.default_rng(count).integers(0, 2**32, count, dtype=np.uint32)
    indices = np.arange(count, dtype=np.uint32)
    key_buffer, value_buffer = ctx.buffer(keys), ctx.buffer(indices)
    count_buffer = ctx.buffer(np.array([count], np.uint32))
    workspace = Workspace()

    def gpu(sorter: RadixSort) -> float:
        key_buffer.write(keys)
        value_buffer.write(indices)
        ctx.finish()
        return timed(lambda: (sorter.sort(key_buffer, value_buffer, count_buffer), ctx.finish()))

    def numba() -> float:
        keyed = keyed_values(keys, indices)
        return timed(lambda: radix_sort(keyed, 32, 1, workspace))

    sorters = {tuning: RadixSort(ctx, count, tuning=tuning) for tuning in dict.fromkeys(tunings)}
    ways: dict[str, Callable[[], float]] = {
        "numpy stable argsort": lambda: timed(lambda: np.argsort(keys, kind="stable")),
        "numba radix, 1 thread": numba,
    }
    ways |= {name_of(tuning): lambda sorter=sorter: gpu(sorter) for tuning, sorter in sorters.items()}
    # What sorts, times itself: the keys are put back before.
    times = {
        name: own.values
        for name, own in in_turn(
            {name: lambda _, way=way: way() for name, way in ways.items()}, repeats
        ).items()
    }
    for thing in (*sorters.values(), key_buffer, value_buffer, count_buffer):
        thing.release()
    base = float(np.median(times["numpy stable argsort"]))
    return {
        "keys": count,
        "ways": [
            {
                "name": name,
                "median_ms": float(np.median(values)),
                "range_ms": [min(values), max(values)],
                "ratio_to_numpy": float(np.median(values)) / base,
            }
            for name, values in times.items()
        ],
    }


def timed(work: Callable[[], object]) -> float:
    began = time.perf_counter()
    work()
    return (time.perf_counter() - began) * 1000


def main() -> None:
    parser = make_parser(__doc__, "sort.json")
    parser.add_argument("--counts", type=int, nargs="+", default=[10_000, 100_000, 500_000, 2_000_000])
    parser.add_argument("--repeats", type=int, default=9)
    parser.add_argument("--tunings", action="store_true")
    options = parser.parse_args()
    ctx = create_headless_context(require=430)
    info = describe(ctx)
    tunings = [SOFTWARE if info.is_software else HARDWARE]
    tunings += OTHER_TUNINGS if options.tunings else []
    results = []
    for count in options.counts:
        results.append(compare(ctx, count, options.repeats, tunings))
        print(results[-1], flush=True)
    write_results(
        options.output,
        {
            "gl": info.renderer,
            "results": results,
            "table": {
                "columns": ["keys", *(f"{way['name']}, ms" for way in results[0]["ways"])],
                "rows": [
                    [
                        f"{result['keys']:,}",
                        *(f"{way['median_ms']:.1f} ({way['ratio_to_numpy']:.2f}x)" for way in result["ways"]),
                    ]
                    for result in results
                ],
                "note": f"32-bit keys with 32-bit values, median of {options.repeats} in turn,"
                f" times relative to numpy's in brackets; GL is {info.renderer}.",
            },
        },
    )


if __name__ == "__main__":
    main()
