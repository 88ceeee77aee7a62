"""Every variant of the shaders through the compiler of Khronos, as strict as the strictest driver."""

from __future__ import annotations

import itertools
import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from splatview.renderers.gl.edit_textures import Editing
from splatview.renderers.gl.programs import expand
from splatview.renderers.gl.project import QUADS_PER_INSTANCE
from splatview.renderers.gl.quads_gl33 import NO_ORDERS
from splatview.renderers.gl.scene_buffers import GROUP_SIZE
from splatview.renderers.gl.tiles import BLOCK, HARDWARE, SOFTWARE
from splatview.renderers.modes import MODES, VisualMode, mode_flags
from splatview.renderers.request import Highlight
from splatview.scene.edits import IDENTITY, Crop

Variant = tuple[str, dict[str, float | bool]]

RAYS: list[dict[str, float | bool]] = [
    {"LENS": a, "ORTHOGRAPHIC": b, "DISCS": False} for a, b in ((False, False), (True, False), (False, True))
]
PINHOLE = RAYS[0]

BLENDED: list[VisualMode] = [mode.name for mode in MODES.values() if not mode.surfaces]

GEOMETRY: dict[str, float | bool] = {"QUADS_PER_INSTANCE": QUADS_PER_INSTANCE, "GROUP_SIZE": GROUP_SIZE}


def edited() -> Iterator[Editing]:
    for hides, adjusts, crops, tints in itertools.product((False, True), repeat=4):
        yield Editing(
            hides=hides,
            palette=(IDENTITY,) if adjusts else None,
            crops=(Crop(),) if crops else (),
            highlight=Highlight() if tints else None,
        )


def projections(name: str) -> Iterator[Variant]:
    own = {**PINHOLE, "SH_WORDS": 48, "OWN_DEGREES": False, "WIDE": False, "DEPTH": False}
    own |= {"ATTRIBUTES": 0, "NORMALS": False}
    for attributes, own_degrees in itertools.product(range(3), (False, True)):
        flags = {"SH_DEGREE": 3, "ANTIALIASED": False, "ATTRIBUTES": attributes, "OWN_DEGREES": own_degrees}
        yield name, {**GEOMETRY, **own, **flags, **Editing().flags()}
    yield name, {**GEOMETRY, **own, "SH_DEGREE": 0, "ANTIALIASED": False, "WIDE": True, **Editing().flags()}
    for editing in edited():
        yield name, {**GEOMETRY, **own, "SH_DEGREE": 3, "ANTIALIASED": False, **editing.flags()}
    for degree, antialiased, depth in itertools.product(range(4), (False, True), (False, True)):
        flags = {"SH_DEGREE": degree, "ANTIALIASED": antialiased, "DEPTH": depth}
        yield name, {**GEOMETRY, **own, **flags, **Editing().flags()}
    for rays, discs, normals in itertools.product(RAYS, (False, True), (False, True)):
        flags = {"SH_DEGREE": 0, "ANTIALIASED": False, **rays, "DISCS": discs, "NORMALS": normals}
        yield name, {**GEOMETRY, **own, **flags, **Editing().flags()}
    textured = {"TEXTURED": True, "DISCS": True, "SLOPES": True, **Editing().flags()}
    yield name, {**GEOMETRY, **own, "SH_DEGREE": 0, "ANTIALIASED": False, **textured}


def drawing(folder: str) -> Iterator[Variant]:
    for editing in edited():
        flags = editing.flags(shows="ellipsoids")
        for attributes in range(3):
            own = {**RAYS[attributes], "ANTIALIASED": False, "ATTRIBUTES": attributes}
            yield f"{folder}/ellipsoids.vert.glsl", {**GEOMETRY, **own, **flags}
    orders = [NO_ORDERS]
    if folder == "quads":
        orders = [{"STOCHASTIC": a, "WEIGHTED": b} for a, b in ((False, False), (True, False), (False, True))]
    for mode in BLENDED:
        for highlight, order in itertools.product((None, Highlight()), orders):
            edits = Editing(highlight=highlight).flags(projects=False, shows="splats")
            flags = {**GEOMETRY, **mode_flags(mode), **edits, **order}
            yield f"{folder}/draw.vert.glsl", flags
            yield "quads/draw.frag.glsl", flags
            behind: dict[str, float | bool] = {"GRADIENT": False, "PANORAMA": False, "BEHIND": False}
            for kind in (None, *behind):
                flags = {**behind, **({kind: True} if kind else {}), **mode_flags(mode, resolved=True)}
                yield "quads/resolve.frag.glsl", {**flags, "WEIGHTED": order.get("WEIGHTED", False)}
    for rays in RAYS:
        yield "quads/ellipsoids.frag.glsl", rays
    yield "quads/fullscreen.vert.glsl", {}


def tiles() -> Iterator[Variant]:
    for tuning in (SOFTWARE, HARDWARE):
        pairs = {"WORKGROUP": tuning.pairs.workgroup, "RUN": BLOCK // tuning.pairs.workgroup, "BLOCK": BLOCK}
        for name in ("count", "emit", "plan", "scan"):
            for textured in (False, True):
                own = {"TILE": tuning.tile, "ROUNDS": 16, "TEXTURED": textured, "TEXTURE_WIDTH": 2048}
                yield f"tiles/{name}.comp.glsl", {**pairs, **own}
        for rest, highlight in itertools.product((False, True), (None, Highlight())):
            own = {"WORKGROUP": tuning.workgroup, "BATCH": tuning.batch, "TILE": tuning.tile, "ROUNDS": 16}
            edits = Editing(highlight=highlight).flags(projects=False, shows="splats")
            yield "tiles/blend.comp.glsl", {**own, "REST": rest, **edits}
            yield "tiles/blend.comp.glsl", {**own, "REST": rest, "TEXTURED": True, "DISCS": True, **edits}


@pytest.mark.parametrize(
    ("version", "variants"),
    [
        ("430 core", [*projections("quads/project.comp.glsl"), *drawing("quads"), *tiles()]),
        ("330 core", [*projections("quads_gl33/project.frag.glsl"), *drawing("quads_gl33")]),
    ],
    ids=["4.3", "3.3"],
)
def test_every_variant_compiles(tmp_path: Path, version: str, variants: list[Variant]):
    compiler = shutil.which("glslangValidator")
    if compiler is None:
        pytest.skip("glslangValidator is not installed (apt-get install glslang-tools)")
    sources = {}
    for (name, flags), general in itertools.product(variants, (False, True)):
        source, _ = expand(name, version, flags, general=general)
        sources.setdefault(source, name.split(".")[-2])  # many have one general program
    files = []
    for number, (source, stage) in enumerate(sources.items()):
        file = tmp_path / f"{number}.{stage}"
        file.write_text(source, encoding="utf8")
        files.append(file.name)
    done = subprocess.run([compiler, *files], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-3000:]
    assert all(file in done.stdout for file in files)


SHADERS = Path(__file__).parents[3] / "shaders"


def test_shared_memory_is_flushed_before_every_barrier():
    """OpenGL 4.3's own words ask for it, though no current driver does."""
    for path in SHADERS.rglob("*.glsl"):
        for number, line in enumerate(path.read_text(encoding="utf8").splitlines(), 1):
            if re.search(r"(?<!\w)barrier\(\)", line):
                assert "memoryBarrierShared(); barrier();" in line, f"{path.name}:{number}"


def test_nan_meets_a_comparison_before_min():
    """min(NaN, x) may be x: alphas are compared with the cut before they are capped."""
    for path in SHADERS.rglob("*.glsl"):
        assert not re.search(r"min\([^;]*exp2[^;]*max_alpha\)", path.read_text(encoding="utf8")), path.name
