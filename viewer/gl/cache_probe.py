"""Whether this driver keeps the programs of one process for another: tried with some never seen before."""

from __future__ import annotations

import secrets
import time
from dataclasses import dataclass

import moderngl

from ...scene import RenderSettings
from ...scene.framing import frame_camera
from . import make_renderer
from .rehearsal import SIZE, few_splats, rehearsal_of
from .rehearsing import in_a_process
from .variants import Variant, Variants, load

WORTH_WHILE = 0.5
"""Of the time that a new program takes: more, and nothing was kept. It is a tenth with Mesa."""


@dataclass(frozen=True, kw_only=True)
class CacheProbe:
    works: bool
    why: str


def probe_cache(ctx: moderngl.Context) -> CacheProbe:
    """Compiles a program here, and one here after another process has compiled it; takes two seconds."""
    few, settings = few_splats(), RenderSettings()
    camera = frame_camera(few, *SIZE)
    variants = Variants(ctx)
    renderer = make_renderer(ctx, "quads", variants)
    renderer.render(few, camera, settings)
    known = next(variant for variant in variants.made if "project" in variant.files[-1])
    renderer.release()
    unknown, elsewhere = (never_seen(known) for _ in range(2))
    alone = compile_ms(ctx, unknown)
    try:
        in_a_process(rehearsal_of("quads", few, camera, settings, variants=frozenset({elsewhere})))
    except RuntimeError as error:
        return CacheProbe(works=False, why=f"a second process cannot draw: {error}")
    after = compile_ms(ctx, elsewhere)
    found = f"a new program takes {alone:.0f} ms, one that another process has compiled {after:.0f} ms"
    return CacheProbe(works=after <= WORTH_WHILE * alone, why=found)


def never_seen(known: Variant) -> Variant:
    """The same program with a number in it that no other has had."""
    return Variant.of(known.files, {**dict(known.flags), "TEXTURE_WIDTH": 2048 + secrets.randbelow(1 << 30)})


def compile_ms(ctx: moderngl.Context, variant: Variant) -> float:
    begun = time.perf_counter()
    load(ctx, variant).release()
    ctx.finish()
    return 1000 * (time.perf_counter() - begun)
