"""The list of command lines that are recorded, each under a readable key."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from .inputs import CAMERAS, RECIPES, SCENES, WRONG_STEPS

IN = "../../in"
"""Folder of the input files, from the folder that each entry runs in."""

DEMO = f"{IN}/demo.ply"

PIXELS = 4096
"""Largest pictures of the reference renderer, which tests each splat at each pixel."""

SHARED_SCENES = {"train-1000": "train-1000.ply", "skull": "skull.ply", "playbot": "playbot_lod0.ply"}
CAPTURES = {"banana": 12, "miku": 24}
"""Folder of a capture -> the factor by which its photos are made smaller."""

OTHER_FORMATS = (
    "skull.sog",
    "spot_10k.splat",
    "biker/biker.spz",
    "biker/biker.compressed.ply",
    "stfix/minimal.ksplat",
)

BACKENDS: dict[str, tuple[str, ...]] = {
    "cpu": ("--renderer", "cpu"),
    "quads": ("--renderer", "quads"),
    "tiles": ("--renderer", "tiles"),
    "quads-gl33": ("--renderer", "quads"),
    "reference": ("--renderer", "reference"),
}
FAST = ("cpu", "quads", "tiles", "quads-gl33")
OLD_GL = {"MESA_GL_VERSION_OVERRIDE": "3.3"}

KNOBS = {
    "sh-degree": ("3", "2", "1", "0"),
    "blend": ("float32", "float16", "unorm8"),
    "early-stop": ("0", "1e-4", "1e-2"),
    "order": ("32-bit", "16-bit", "per-pixel", "weighted", "stochastic"),
    "cut": ("1/255", "3-sigma", "2-sigma"),
    "resolution": ("1", "1/2", "1/4"),
    "keep": ("100", "75", "50", "25"),
    "attributes": ("float32", "float16", "8-bit-sh"),
    "resort": ("1", "4", "5deg", "16"),
}

MODES = ("splats", "points", "ellipsoids", "depth", "overdraw")

LENSES = (
    "SIMPLE_RADIAL:0.1",
    "RADIAL:-0.1,0.02",
    "OPENCV:-0.1,0.02,0.003,-0.002",
    "OPENCV_FISHEYE:0.1,0,0.01,0",
    "FULL_OPENCV:0.1,0.02,0.001,0.002,0.01,0.05,0.01,0",
    "RADIAL4:0.05,0.01,0.001,0,0.002,0.001",
    "FOV:0.9",
    "SIMPLE_RADIAL_FISHEYE:0.05",
    "RADIAL_FISHEYE:0.05,-0.01",
    "THIN_PRISM_FISHEYE:0.02,0.01,0.001,0.002,0.001,0,0.002,0.001",
    "RAD_TAN_THIN_PRISM_FISHEYE:0.02,0.01,0,0,0,0,0.001,0.002,0.001,0,0.001,0",
    "PINHOLE",
)

EYE = ("--eye", "1.2,-0.8,-2.2", "--target", "0,0.1,0", "--up", "0.2,-1,0", "--fov", "38")
INSIDE = ("--eye", "0.1,0.1,-0.2", "--target", "1,0.2,0.4", "--fov", "95")


@dataclass(frozen=True, kw_only=True)
class Entry:
    """One or more runs of `splatview`, one after the other in a folder of their own."""

    key: str
    commands: tuple[tuple[str, ...], ...]
    """Arguments of `splatview`. The scene "sh0" is `IN/sh0.ply`."""
    environment: dict[str, str] = field(default_factory=dict)
    copies: tuple[str, ...] = ()
    """Input files that are copied into the folder first."""
    collect: tuple[str, ...] = ("**/*",)
    """Patterns of the files that are recorded, from the folder."""
    says_times: bool = False
    """Whether times in what is printed depend on the clock."""
    ignore_stderr: bool = False
    """Whether standard error holds a progress bar."""


def entry(key: str, *arguments: str, **options) -> Entry:
    return Entry(key=key, commands=(arguments,), **options)


def scene(name: str) -> str:
    return f"{IN}/{name}.ply"


def picture(
    key: str, backend: str, name: str, *options: str, size: str = "97x70", output: str = "o.npy"
) -> Entry:
    """A render of the scene `name`, to `output`."""
    environment = OLD_GL if backend == "quads-gl33" else {}
    sized = ("--size", size) if size else ()
    arguments = ("render", scene(name), "-o", output, *BACKENDS[backend], *sized, *options)
    return entry(f"render/{key}/{backend}", *arguments, environment=environment)


def all_entries(scenes: Path | None, captures: Path | None) -> list[Entry]:
    """Long ones first, so that no processor is idle at the end.

    `scenes` and `captures`: folders of shared data; None leaves out what needs them.
    """
    entries = [
        *stability(),
        *training(captures),
        *(pictures_of_shared_scenes(scenes) if scenes else ()),
        *pictures_of_the_demo(),
        *views(),
        *knobs(),
        *modes(),
        *rays(),
        *looks(),
        *every_scene(),
        *frames(),
        *reports(scenes),
        *edits(scenes),
        *mistakes(scenes),
        *mistakes_of_edit(),
        *mistakes_of_train(),
        *helps(),
    ]
    keys = [one.key for one in entries]
    twice = sorted({key for key in keys if keys.count(key) > 1})
    assert not twice, f"two entries have one key: {twice}"
    return entries


def stability() -> Iterator[Entry]:
    for name in ("quads", "cpu", "tiles", "quads-gl33", "reference"):
        yield entry(f"stability/{name}", "stability", "--renderer", name, "--json")
    yield entry("stability/list", "stability", "--list")
    yield entry("stability/list-json", "stability", "--list", "--json")
    yield entry("stability/table", "stability", "--renderer", "reference", "--all")
    case = ("stability", "--renderer", "cpu", "--case", "needle of a disc", "--save", "out")
    yield entry("stability/one-case", *case)


TRAIN = ("--headless", "--seed", "1", "--threads", "2", "-o", "o.ply", "--metrics", "o.jsonl")
RESUMED = ("--headless", "--threads", "2", "-o", "o.ply", "--metrics", "o.jsonl")
CHECKPOINT = ("--resume", "o.checkpoint.safetensors")


def training(captures: Path | None) -> Iterator[Entry]:
    """Short seeded runs; `--resume` goes on in the same folder."""

    def run(key: str, capture: tuple[str, ...], options: tuple[str, ...], **more) -> Entry:
        return entry(f"train/{key}", "train", *capture, *TRAIN, *options, says_times=True, **more)

    steps = ("--iterations", "200")
    demo = ("--demo", "--downscale", "4")
    yield Entry(
        key="train/demo-resumed",
        commands=(
            ("train", *demo, *TRAIN, "--iterations", "120"),
            ("train", "--demo", *RESUMED, *CHECKPOINT, "--iterations", "200"),
        ),
        says_times=True,
        collect=("**/*", "../../cache/demo-photos-*/**/*"),
    )
    if captures is None:
        return
    for name, factor in CAPTURES.items():
        folder = (f"{IN}/captures/{name}",)
        small = ("--downscale", str(factor))
        yield run(name, folder, (*steps, *small))
        if name == "banana":
            classic = ("--strategy", "classic", "--abs-grad", "--exposure", "on")
            yield run(f"{name}-classic", folder, (*small, *classic, "--iterations", "300"))
            other = ("--batch", "2", "--antialiased", "on", "--coarse", "none", "--max-splats", "2600")
            yield run(f"{name}-mcmc", folder, (*small, *other, "--iterations", "150"))
            lensed = (f"{IN}/lensed",)
            short = ("--eval-every", "20", "--iterations", "40")
            yield run("lens-through", lensed, (*small, *short))
            yield run("lens-undistorted", lensed, (*small, *short, "--lens", "undistort"))
            yield Entry(
                key=f"train/{name}-resumed",
                commands=(
                    ("train", *folder, *TRAIN, *small, "--iterations", "100"),
                    ("train", *folder, *RESUMED, *CHECKPOINT, "--iterations", "200"),
                ),
                says_times=True,
            )


def pictures_of_shared_scenes(scenes: Path) -> Iterator[Entry]:
    for name, views in {
        "playbot": {"framed": (), "fov": ("--fov", "20")},
        "skull": {"framed": (), "near": ("--near", "2", "--fov", "30"), "depth": ("--orthographic",)},
        "train-1000": {"framed": (), "fov": ("--fov", "25"), "parallel": ("--orthographic",)},
    }.items():
        if not (scenes / SHARED_SCENES[name]).exists():
            continue
        for view, options in views.items():
            for backend in FAST:
                size = "203x131" if view == "framed" else "101x67"
                yield picture(f"{name}/{view}", backend, name, *options, size=size)
        for backend in FAST:
            yield picture(f"{name}/antialiased", backend, name, "--antialiased", "--blur", "0.1")
    if (scenes / SHARED_SCENES["train-1000"]).exists():
        yield picture("train-1000/framed", "reference", "train-1000", size="75x53")


def pictures_of_the_demo() -> Iterator[Entry]:
    for backend in FAST:
        yield picture("demo/framed", backend, "demo", size="160x90")
        yield picture("demo/near", backend, "demo", "--fov", "15", "--sh-degree", "2")
    yield picture("demo/overdraw", "quads", "demo", "--mode", "overdraw")
    yield entry("window/demo-preview-tiles", "--renderer", "tiles", "-o", "preview.png")
    yield entry("window/two-scenes-cpu", scene("sh0"), scene("mip"), "--renderer", "cpu", "-o", "o.png")
    yield entry("window/one-scene", scene("random"), "-o", "o.png")


def views() -> Iterator[Entry]:
    """Cameras from options and from files."""
    file = ("--camera", f"{IN}/cameras.json")
    for backend in BACKENDS:
        small = "53x37" if backend == "reference" else "97x70"
        yield picture("view/framed", backend, "random", size=small)
        yield picture("view/eye", backend, "random", *EYE, size=small)
        yield picture("view/inside", backend, "random", *INSIDE, size=small)
        for index, camera in enumerate(CAMERAS):
            key = f"view/file {camera['name']}"
            yield picture(key, backend, "random", *file, "--camera-index", str(index), size="")
        for size in ("1x1", "17x9", "64x48"):
            yield picture(f"view/{size}", backend, "random", size=size)
    for backend in FAST:
        yield picture("view/larger", backend, "random", size="333x211")
    yield picture("view/by-name", "cpu", "random", *file, "--camera-name", "off-centre", size="")
    yield picture("view/resized", "cpu", "random", *file, "--camera-index", "1", size="90x40")
    yield picture("view/no-lens", "cpu", "random", *file, "--camera-name", "lens", "--lens", "none", size="")
    for name in ("one-camera", "trained-cameras"):
        yield picture(f"view/{name}", "cpu", "random", "--camera", f"{IN}/{name}.json", size="")


def knobs() -> Iterator[Entry]:
    """Each knob at each value with each backend, whether it has it or refuses it."""
    for name, values in KNOBS.items():
        moving = ("--frames", "6", "--turn", "2") if name == "resort" else ()
        for value in values:
            for backend in BACKENDS:
                size = "53x37" if backend == "reference" else "97x70"
                key = f"knob/{name} {value}"
                yield picture(key, backend, "random", f"--{name}", value, *moving, size=size)
    for backend in FAST:
        together = ("--sh-degree", "1", "--cut", "3-sigma", "--early-stop", "1e-2", "--keep", "50")
        yield picture("knob/together", backend, "random", *together, "--resolution", "1/2")
    for name in ("weighted", "stochastic", "per-pixel"):
        for backend in FAST:
            yield picture(f"knob/order {name} of hard", backend, "hard", "--order", name)


def modes() -> Iterator[Entry]:
    for backend in ("quads", "quads-gl33"):
        for mode in MODES:
            for name in ("random", "hard", "discs"):
                yield picture(f"mode/{mode} {name}", backend, name, "--mode", mode)
            if backend == "quads-gl33":
                continue
            yield picture(f"mode/{mode} lens", backend, "random", "--mode", mode, "--lens", LENSES[2])
            yield picture(f"mode/{mode} parallel", backend, "random", "--mode", mode, "--orthographic")
            painted = ("--mode", mode, "--background", "gradient:#88b0e0,#404038")
            yield picture(f"mode/{mode} gradient", backend, "random", *painted)
    yield picture("mode/depth auto", "quads", "sh1", "--mode", "depth", "--blend", "float32")


def rays() -> Iterator[Entry]:
    """Lenses, parallel rays, depth of field."""
    for index, lens in enumerate(LENSES):
        for backend in BACKENDS if index in (2, 3, 6) else ("cpu", "quads"):
            size = "53x37" if backend == "reference" else "97x70"
            key = f"lens/{lens.partition(':')[0]}"
            yield picture(key, backend, "random", "--lens", lens, "--fov", "70", size=size)
    for backend in BACKENDS:
        size = "53x37" if backend == "reference" else "97x70"
        yield picture("rays/parallel", backend, "random", "--orthographic", size=size)
        yield picture("rays/parallel eye", backend, "hard", *EYE, "--orthographic", size=size)
        wide = ("--aperture", "0.3", "--focus", "2.5", "--lens-samples", "5")
        yield picture("rays/depth of field", backend, "random", *wide, size=size)
        before_sky = (*wide, "--background", "gradient:red,blue")
        yield picture("rays/depth of field, sky", backend, "sh1", *before_sky, size=size)
        yield picture("rays/discs lens", backend, "discs", "--lens", LENSES[2], size=size)
        yield picture("rays/discs parallel", backend, "discs", "--orthographic", size=size)
    through = ("--aperture", "0.3", "--focus", "2.5", "--lens", LENSES[3])
    yield picture("rays/depth of field, lens", "cpu", "sh1", *through)
    yield picture("rays/64 samples", "cpu", "sh0", "--aperture", "0.2", "--focus", "3", size="40x30")


def looks() -> Iterator[Entry]:
    """Image model and background."""
    for backend in BACKENDS:
        size = "53x37" if backend == "reference" else "97x70"
        for key, name, options in (
            ("antialiased", "random", ("--antialiased",)),
            ("no-antialiased", "mip", ("--no-antialiased",)),
            ("discs", "random", ("--footprint", "disc")),
            ("ellipsoids", "discs", ("--footprint", "ellipsoid")),
            ("blur", "random", ("--blur", "0")),
            ("near", "random", ("--near", "3.5")),
            ("colour", "random", ("--background", "0.2,0.4,0.6")),
            ("named colour", "random", ("--background", "#88b0e0")),
            ("gradient", "random", ("--background", "gradient:#88b0e0,#404038")),
            ("gradient eye", "random", ("--background", "gradient:1,0.5,0,0,0,1", *EYE)),
            ("panorama", "random", ("--background", f"{IN}/panorama.png", *EYE)),
            ("panorama lens", "sh1", ("--background", f"{IN}/panorama.png", "--lens", LENSES[3])),
            ("panorama parallel", "sh1", ("--background", f"{IN}/panorama.png", "--orthographic")),
        ):
            yield picture(f"look/{key}", backend, name, *options, size=size)
    yield picture("look/png", "cpu", "random", output="o.png")
    yield picture("look/png colour", "quads", "random", "--background", "1,1,1", output="o.png")
    yield picture("look/alpha", "cpu", "random", "--alpha", output="o.png")
    yield picture("look/alpha", "tiles", "random", "--alpha", output="o.png")


def every_scene() -> Iterator[Entry]:
    for name in SCENES:
        for backend in BACKENDS:
            yield picture(f"scene/{name}", backend, name, size="53x37")


def frames() -> Iterator[Entry]:
    yield entry("render/auto", "render", scene("random"), "-o", "o.npy", "--size", "97x70")
    for backend in ("cpu", "quads", "tiles"):
        moving = ("--frames", "4", "--turn", "7", "--stats")
        yield picture("frames/turned", backend, "random", *moving)
        yield picture("frames/turned eye", backend, "hard", *EYE, *moving)
    stats = ("render", scene("sh2"), "--stats", "--size", "64x48")
    for backend in BACKENDS:
        environment = OLD_GL if backend == "quads-gl33" else {}
        yield entry(f"stats/{backend}", *stats, *BACKENDS[backend], environment=environment)


def reports(scenes: Path | None) -> Iterator[Entry]:
    """info, bill, convert, ladder, doctor."""
    shared = [name for name, file in SHARED_SCENES.items() if scenes and (scenes / file).exists()]
    for name in (*SCENES, "demo", *shared, "no-splats"):
        yield entry(f"info/{name}", "info", scene(name))
        yield entry(f"info-json/{name}", "info", scene(name), "--json")
        yield entry(f"convert/{name}", "convert", scene(name), "o.ply")
    for name in ("random", "hard"):
        yield entry(f"info/{name} repairs", "info", scene(name), "--repairs", "--json")
        yield entry(f"info/{name} repairs text", "info", scene(name), "--repairs")
    measured = ("--measure", "--seconds", "1", "--renderer", "cpu", "--size", "64x48", "--json")
    yield entry("info/measured", "info", scene("random"), *measured, ignore_stderr=True)
    for name in ("random", "hard", "discs", *shared):
        yield entry(f"bill/{name}", "bill", scene(name), "--size", "97x70", "--heatmap", "o.png")
        yield entry(f"bill-json/{name}", "bill", scene(name), *EYE, "--size", "97x70", "--json")
    yield entry("bill/lens", "bill", scene("random"), "--lens", LENSES[3], "--size", "97x70", "--json")
    once = ("--rounds", "1", "--size", "64x48", "--json")
    for backend in ("cpu", "quads", "tiles"):
        arguments = ("ladder", scene("random"), "--renderers", backend, *once)
        yield entry(f"ladder/{backend}", *arguments, ignore_stderr=True)
    some = ("ladder", scene("sh1"), "--renderers", "cpu,tiles", "--knobs", "order,keep", "--views", "1")
    yield entry("ladder/some-knobs", *some, *once, ignore_stderr=True)
    yield entry("doctor", "doctor", "--json", says_times=True)
    yield entry("version", "--version")


def edits(scenes: Path | None) -> Iterator[Entry]:
    for name, (of, _) in RECIPES.items():
        command = ("edit", scene(of), "--recipe", f"{name}.json")
        copies = (f"{name}.json", "more.ply")
        yield Entry(
            key=f"edit/{name}",
            commands=((*command, "-o", "o.ply"), (*command, "--dry-run"), (*command, "--dry-run", "--json")),
            copies=copies,
        )
        if name in ("all-operations", "repairs"):
            priced = (*command, "--dry-run", "--prices")
            yield Entry(key=f"edit/{name} prices", commands=(priced, (*priced, "--json")), copies=copies)
    recipe = ("--recipe", f"{IN}/for-another-scene.json", "-o", "o.ply")
    yield entry("edit/any-scene", "edit", scene("sh0"), *recipe, "--any-scene")
    if scenes and (scenes / SHARED_SCENES["skull"]).exists():
        recipe = ("--recipe", f"{IN}/detectors.json", "-o", "o.ply")
        yield entry("edit/skull", "edit", scene("skull"), *recipe)


BAD_SCENES = (
    "no-opacity.ply",
    "odd-bands.ply",
    "whole-numbers.ply",
    "empty.ply",
    "text.ply",
    "cut.ply",
    "cut-header.ply",
    "promises.ply",
    "negative.ply",
    "no-number.ply",
    "wrong-type.ply",
    "twice.ply",
    "no-format.ply",
    "other-format.ply",
    "no-vertex.ply",
    "mesh.ply",
    "compressed.ply",
    "ascii-cut.ply",
    "ascii-word.ply",
    "scene.spz",
    "scene.sog",
    "scene.splat",
    "scene.ksplat",
    "picture.ply",
    "nowhere.ply",
    "",
)
"""Files that `info` and the others refuse; the last is the folder itself."""

BAD_RENDERS = {
    "unknown option": "--colour red",
    "abbreviated option": "--rend cpu",
    "unknown renderer": "--renderer pixels",
    "blend of tiles": "--renderer tiles --blend float16",
    "knob value": "--renderer cpu --cut 4-sigma",
    "eye without target": "--eye 0,0,1",
    "target without eye": "--target 0,0,1",
    "eye is target": "--eye 0,0,1 --target 0,0,1",
    "two numbers": "--eye 0,1 --target 0,0,1",
    "no number": "--eye 0,1,up --target 0,0,1",
    "not a number": "--eye 0,1,nan --target 0,0,1",
    "no direction": "--eye 0,0,1 --target 0,0,0 --up 0,0,0",
    "up alone": "--up 0,1,0",
    "field of view": "--fov 180",
    "size": "--size 1280",
    "no pixels": "--size 0x10",
    "all the pixels": "--size 65536x65536",
    "too large for OpenGL": "--size 65536x8 --renderer quads",
    "colour": "--background 0,0,255",
    "no such colour": "--background #12",
    "gradient": "--background gradient:red",
    "gradient of five": "--background gradient:1,1,1,0,0",
    "no such background": "--background sky.jpg",
    "background is a scene": f"--background {IN}/sh0.ply",
    "aperture alone": "--aperture 0.1",
    "focus alone": "--focus 3",
    "samples alone": "--lens-samples 3",
    "closed aperture": "--aperture 0 --focus 3",
    "aperture of parallel rays": "--aperture 0.1 --focus 3 --orthographic",
    "sh degree": "--sh-degree 4",
    "near": "--near 0",
    "blur": "--blur=-1",
    "frames": "--frames 0",
    "turn": "--turn inf",
    "lens model": "--lens MIRROR:1",
    "lens numbers": "--lens OPENCV:1,2",
    "lens that folds": "--lens RADIAL:-2,0 --fov 120",
    "lens and parallel": "--lens FOV:0.9 --orthographic",
    "two cameras": f"--camera {IN}/cameras.json --eye 0,0,1 --target 0,0,0",
    "camera with fov": f"--camera {IN}/cameras.json --fov 30",
    "index without camera": "--camera-index 1",
    "index and name": f"--camera {IN}/cameras.json --camera-index 1 --camera-name front",
    "no such index": f"--camera {IN}/cameras.json --camera-index 9",
    "no such name": f"--camera {IN}/cameras.json --camera-name back",
    "no such camera file": "--camera nowhere.json",
    "no camera": f"--camera {IN}/no-camera.json",
    "wrong camera": f"--camera {IN}/wrong-camera.json",
    "wrong lens": f"--camera {IN}/wrong-lens.json",
    "camera not JSON": f"--camera {IN}/no-json.json",
    "camera is a scene": f"--camera {IN}/sh0.ply",
    "mode on the cpu": "--mode depth --renderer cpu",
    "unknown mode": "--mode wires",
    "alpha and background": "--alpha --background 0,0,0",
    "extra": "extra",
}

BAD_COMMANDS = {
    "unknown command": "rendr",
    "no such scene": "nowhere.ply",
    "unknown window option": "--full",
    "window renderer": f"{IN}/sh0.ply --renderer reference",
    "preview suffix": f"{IN}/sh0.ply -o o.jpg",
    "render without scene": "render",
    "render to nothing": f"render {IN}/sh0.ply",
    "render suffix": f"render {IN}/sh0.ply -o o.jpg",
    "render no suffix": f"render {IN}/sh0.ply -o o",
    "render no folder": f"render {IN}/sh0.ply -o no/o.png",
    "render to a folder": f"render {IN}/sh0.ply -o {IN}",
    "alpha in npy": f"render {IN}/sh0.ply -o o.npy --alpha",
    "info without scene": "info",
    "info option": f"info {IN}/sh0.ply --yaml",
    "info extra": f"info {IN}/sh0.ply extra",
    "info size without measure": f"info {IN}/sh0.ply --size 9x9",
    "info seconds without measure": f"info {IN}/sh0.ply --seconds 3",
    "bill suffix": f"bill {IN}/sh0.ply --heatmap o.txt",
    "bill damaged": f"bill {IN}/cut.ply",
    "convert without output": f"convert {IN}/sh0.ply",
    "convert suffix": f"convert {IN}/sh0.ply o.png",
    "convert damaged": f"convert {IN}/cut.ply o.ply",
    "convert no folder": f"convert {IN}/sh0.ply no/o.ply",
    "ladder without scene": "ladder",
    "ladder knob": f"ladder {IN}/sh0.ply --knobs blur",
    "ladder renderer": f"ladder {IN}/sh0.ply --renderers reference",
    "ladder lengths": f"ladder {IN}/sh0.ply --seconds 3 --rounds 2",
    "ladder minutes": f"ladder {IN}/sh0.ply --minutes 3",
    "ladder plot": f"ladder {IN}/sh0.ply --plot o.txt",
    "ladder scene and train": f"ladder {IN}/sh0.ply --train demo",
    "ladder train": "ladder --train nowhere",
    "stability renderer": "stability --renderer pixels",
    "stability case": "stability --case spoons",
    "doctor extra": "doctor extra",
}


def mistakes(scenes: Path | None) -> Iterator[Entry]:
    for name in BAD_SCENES:
        yield entry(f"mistake/scene {name or 'folder'}", "info", f"{IN}/{name}")
    for name in ("cut.ply", "mesh.ply", "nowhere.ply"):
        yield entry(f"mistake/render {name}", "render", f"{IN}/{name}", "-o", "o.png")
        yield entry(f"mistake/window {name}", f"{IN}/{name}", "-o", "o.png")
    for name in OTHER_FORMATS if scenes else ():
        yield entry(f"mistake/format {name}", "info", f"{IN}/scenes/{name}")
    for key, options in BAD_RENDERS.items():
        arguments = ("render", scene("sh0"), "-o", "o.png", *options.split())
        yield entry(f"mistake/render {key}", *arguments)
    for key, command in BAD_COMMANDS.items():
        yield entry(f"mistake/{key}", *command.split())


def mistakes_of_edit() -> Iterator[Entry]:
    for name in WRONG_STEPS:
        recipe = ("--recipe", f"{IN}/wrong-{name}.json")
        yield entry(f"mistake/edit step {name}", "edit", scene("sh0"), *recipe, "-o", "o.ply")
    good = ("--recipe", f"{IN}/nothing.json")
    both = ("--recipe", f"{IN}/one-name-twice.json", "-o", f"{IN}/both.ply")
    for key, arguments in {
        "without recipe": (scene("sh0"),),
        "without output": (scene("sh0"), *good),
        "no folder": (scene("sh0"), *good, "-o", "no/o.ply"),
        "suffix": (scene("sh0"), *good, "-o", "o.xyz"),
        "no such recipe": (scene("sh0"), "--recipe", "nowhere.json", "-o", "o.ply"),
        "recipe not JSON": (scene("sh0"), "--recipe", f"{IN}/no-json.json", "-o", "o.ply"),
        "recipe is cameras": (scene("sh0"), "--recipe", f"{IN}/cameras.json", "-o", "o.ply"),
        "other version": (scene("sh0"), "--recipe", f"{IN}/other-version.json", "-o", "o.ply"),
        "other scene": (scene("sh0"), "--recipe", f"{IN}/for-another-scene.json", "-o", "o.ply"),
        "damaged scene": (f"{IN}/cut.ply", *good, "-o", "o.ply"),
        "one name twice": (scene("sh0"), *both),
    }.items():
        yield entry(f"mistake/edit {key}", "edit", *arguments)


def mistakes_of_train() -> Iterator[Entry]:
    for name in (
        "empty-capture",
        "no-frames",
        "no-json",
        "no-photos",
        "damaged-colmap",
        "nowhere",
        "sh0.ply",
    ):
        yield entry(f"mistake/train {name}", "train", f"{IN}/{name}", "--headless")
    for key, options in {
        "nothing": "--headless",
        "two captures": f"{IN}/no-frames --demo --headless",
        "without display": "--demo",
        "suffix": "--demo --headless -o o.txt",
        "no folder": "--demo --headless -o no/o.ply",
        "iterations": "--demo --headless --iterations 0",
        "coarse": "--demo --headless --coarse 0.3",
        "coarse order": "--demo --headless --coarse 0.5:2,0.3:4",
        "strategy": "--demo --headless --strategy hope",
        "abs-grad": "--demo --headless --abs-grad --iterations 9",
        "no such checkpoint": "--demo --headless --resume nowhere.safetensors",
        "no checkpoint": f"--demo --headless --resume {IN}/sh0.ply",
        "seed": "--demo --headless --seed -1",
    }.items():
        yield entry(f"mistake/train {key}", "train", *options.split())


COMMANDS = ("render", "info", "stability", "ladder", "bill", "train", "edit", "convert", "doctor")


def helps() -> Iterator[Entry]:
    yield entry("help", "--help")
    for name in COMMANDS:
        yield entry(f"help/{name}", name, "--help")


def warm_up() -> Sequence[Entry]:
    """Run one after the other before all others: the bundled demo is made, and kernels are compiled, so that
    no later entry says that it waits for them. Only the demo is recorded."""
    demo = ("**/*", "../../cache/demo-*.ply")
    return (
        entry("warm-up/compile", "render", scene("sh0"), "-o", "o.npy", "--renderer", "cpu", "--size", "9x9"),
        entry("window/demo-preview", "-o", "preview.png", collect=demo),
        entry("warm-up/train", "train", "--demo", *TRAIN, "--downscale", "8", "--iterations", "2"),
    )
