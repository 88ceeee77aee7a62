"""Every loader of the program as one call for the fuzzers: bytes in, loaded or refused."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import whole_files as whole

from splatview.edit.document import Document
from splatview.edit.journal import SUFFIX, find_abandoned_journals
from splatview.edit.recipe import Recipe, load_recipe, replay, steps_from_json
from splatview.scene import InputError
from splatview.scene.captures import load_capture
from splatview.scene.effects.report import effects_report
from splatview.scene.formats import load_cameras, load_scene
from splatview.scene.formats.panorama import load_panorama
from splatview.scene.health import check
from splatview.trainer.checkpoint import load_checkpoint
from splatview.viewer.camera import camera_from_text
from splatview.viewer.preferences import FILE_NAME, beside, load_bookmarks, load_preferences

CORPUS = Path(__file__).parent / "corpus"
"""`corpus/LOADER/`: files that once made a loader fail, minimised, and such that reach into its corners."""


@dataclass(frozen=True, kw_only=True)
class Loader:
    """A way in for files. `call` gets the folder that `around` has filled, with the damaged file in it."""

    name: str
    file: str
    """Where the damaged bytes are put, relative to the folder."""
    seeds: Callable[[], Sequence[bytes]]
    """Whole files, and such as other programs write."""
    call: Callable[[Path], bool]
    """True: loaded, False: refused in the loader's own way. Raises InputError where it refuses, else what
    it should not."""
    around: Callable[[], Mapping[str, bytes]] = dict
    """The files that lie beside it, whole ones."""
    words: Sequence[bytes] = ()
    """Of the format, for the fuzzer to put in."""

    def corpus(self) -> list[bytes]:
        """Whole files first, then those of the corpus folder, by name."""
        kept = sorted((CORPUS / self.name).glob("*"))
        return [*self.seeds(), *(path.read_bytes() for path in kept)]


def _load_ply(folder: Path) -> bool:
    load_scene(folder / "scene.ply")
    return True


def _load_named(name: str) -> Callable[[Path], bool]:
    def load(folder: Path) -> bool:
        load_scene(folder / name)
        return True

    return load


def _ply_info(folder: Path) -> bool:
    """What the program asks of every scene it opens."""
    gaussians = load_scene(folder / "scene.ply")
    check(gaussians)
    effects_report(gaussians)
    return True


def _cameras_of(name: str) -> Callable[[Path], bool]:
    return lambda folder: len(load_cameras(folder / name)) > 0


def _photos() -> dict[str, bytes]:
    return {f"images/p{i}.png": whole.photo(i) for i in range(3)}


def _colmap(*, text: bool = False) -> dict[str, bytes]:
    """A capture of three views."""
    if text:
        model = {"cameras.txt": whole.cameras_txt((1, 1, 1)), "images.txt": whole.images_txt()}
        model["points3D.txt"] = whole.points_txt()
    else:
        model = {"cameras.bin": whole.cameras_bin((1, 1, 1)), "images.bin": whole.images_bin()}
        model["points3D.bin"] = whole.points_bin()
    return _photos() | {f"sparse/0/{name}": data for name, data in model.items()}


def _load_panorama(folder: Path) -> bool:
    load_panorama(folder / "sky.png")
    return True


def _load_folder(folder: Path) -> bool:
    return len(load_capture(folder).photos) > 0


def _load_recipe(folder: Path) -> bool:
    recipe = load_recipe(folder / "recipe.json")
    # What was understood can be written, and comes back as it was.
    text = json.dumps([step.to_json() for step in recipe.steps], allow_nan=False)
    again = steps_from_json(json.loads(text), "again")
    if [step.to_json() for step in again] != [step.to_json() for step in recipe.steps]:
        raise AssertionError("a recipe does not come back from its own JSON")
    return True


_SCENE = whole.splats(12, 1)


def _replay_recipe(folder: Path) -> bool:
    """Steps that touch files are left out: a damaged path could lie anywhere."""
    recipe = load_recipe(folder / "recipe.json")
    steps = tuple(step for step in recipe.steps if not hasattr(step, "path"))[:8]
    replay(Recipe(steps=steps, scene={}), Document(_SCENE))
    return True


def _find_journals(folder: Path) -> bool:
    return len(find_abandoned_journals(folder)) > 0


def _load_preferences(folder: Path) -> bool:
    os.environ["SPLATVIEW_CONFIG_DIR"] = str(folder)
    return load_preferences()[1] is None


def _load_bookmarks(folder: Path) -> bool:
    os.environ["SPLATVIEW_CONFIG_DIR"] = str(folder / "none")
    return load_bookmarks(folder / "scene.ply") is not None


def _clipboard(folder: Path) -> bool:
    text = (folder / "text").read_bytes().decode("utf-8", "replace")
    try:
        camera_from_text(text)
    except ValueError as error:
        raise InputError(str(error)) from None
    return True


def _load_checkpoint(folder: Path) -> bool:
    load_checkpoint(folder / "run.safetensors")
    return True


LOADERS: tuple[Loader, ...] = (
    Loader(name="ply", file="scene.ply", seeds=whole.plys, call=_load_ply, words=whole.PLY_WORDS),
    Loader(name="ply_info", file="scene.ply", seeds=whole.plys, call=_ply_info, words=whole.PLY_WORDS),
    *(
        Loader(
            name=f"scene_{suffix}",
            file=f"scene.{suffix}",
            seeds=partial(whole.packed, suffix),
            call=_load_named(f"scene.{suffix}"),
        )
        for suffix in ("spz", "splat", "ksplat", "sog", "glb")
    ),
    Loader(
        name="scene_gltf",
        file="scene.gltf",
        seeds=whole.gltfs,
        call=_load_named("scene.gltf"),
        around=whole.gltf_buffer,
    ),
    Loader(
        name="scene_compressed",
        file="scene.ply",
        seeds=lambda: whole.packed("compressed.ply"),
        call=_load_ply,
        words=(*whole.PLY_WORDS, *whole.COMPRESSED_WORDS),
    ),
    Loader(
        name="scene_sog_meta",
        file="meta.json",
        seeds=lambda: [whole.sog_folder()["meta.json"]],
        call=_load_named("meta.json"),
        around=lambda: {name: data for name, data in whole.sog_folder().items() if name != "meta.json"},
    ),
    Loader(
        name="scene_lod_meta",
        file="lod-meta.json",
        seeds=lambda: [whole.lod_meta()],
        call=_load_named("lod-meta.json"),
        around=lambda: {
            f"{chunk}/{name}": data for chunk in ("0_0", "1_0") for name, data in whole.sog_folder().items()
        },
    ),
    Loader(name="cameras_json", file="c.json", seeds=whole.camera_lists, call=_cameras_of("c.json")),
    Loader(
        name="colmap_cameras_bin",
        file="cameras.bin",
        seeds=lambda: [whole.cameras_bin((1, 4, 5)), whole.cameras_bin(range(12))],
        call=_cameras_of("cameras.bin"),
        around=lambda: {"images.bin": whole.images_bin()},
    ),
    Loader(
        name="colmap_images_bin",
        file="images.bin",
        seeds=lambda: [whole.images_bin()],
        call=_cameras_of("images.bin"),
        around=lambda: {"cameras.bin": whole.cameras_bin((1, 1, 1))},
    ),
    Loader(
        name="colmap_cameras_txt",
        file="cameras.txt",
        seeds=lambda: [whole.cameras_txt((1, 4, 5)), whole.cameras_txt(range(12))],
        call=_cameras_of("cameras.txt"),
        around=lambda: {"images.txt": whole.images_txt()},
        words=[name.encode() for name in whole.LENS_NAMES],
    ),
    Loader(
        name="colmap_images_txt",
        file="images.txt",
        seeds=lambda: [whole.images_txt()],
        call=_cameras_of("images.txt"),
        around=lambda: {"cameras.txt": whole.cameras_txt((1, 1, 1))},
    ),
    Loader(
        name="capture_cameras_bin",
        file="sparse/0/cameras.bin",
        seeds=lambda: [whole.cameras_bin((1, 4, 5)), *(whole.cameras_bin((i, i, i)) for i in range(12))],
        call=_load_folder,
        around=_colmap,
    ),
    Loader(
        name="capture_points_bin",
        file="sparse/0/points3D.bin",
        seeds=lambda: [whole.points_bin()],
        call=_load_folder,
        around=_colmap,
    ),
    Loader(
        name="capture_points_txt",
        file="sparse/0/points3D.txt",
        seeds=lambda: [whole.points_txt()],
        call=_load_folder,
        around=lambda: _colmap(text=True),
    ),
    Loader(
        name="capture_held_out",
        file="sparse/0/test.txt",
        seeds=lambda: [b"p0.png\np1.png\n", b"./p2.png"],
        call=_load_folder,
        around=_colmap,
    ),
    Loader(
        name="capture_transforms",
        file="transforms.json",
        seeds=whole.transforms_files,
        call=_load_folder,
        around=_photos,
    ),
    Loader(
        name="capture_camera_list",
        file="cameras.json",
        seeds=lambda: [json.dumps(whole.trainer_list()).encode()],
        call=_load_folder,
        around=_photos,
    ),
    Loader(
        name="capture_poses_bounds",
        file="poses_bounds.npy",
        seeds=whole.poses_bounds,
        call=_load_folder,
        around=_photos,
        words=[
            b"'descr'",
            b"'shape'",
            b"'fortran_order'",
            b"<f8",
            b"|O",
            b"(3, 17)",
            b"(3, 17,)",
            b"(99999999999, 17)",
        ],
    ),
    Loader(
        name="capture_points_ply",
        file="points3d.ply",
        seeds=whole.plys,
        call=_load_folder,
        around=lambda: {**_photos(), "transforms.json": whole.transforms()},
        words=whole.PLY_WORDS,
    ),
    Loader(
        name="capture_photo",
        file="images/p1.png",
        seeds=whole.photos,
        call=_load_folder,
        around=_colmap,
    ),
    Loader(
        name="capture_mask",
        file="masks/p1.png",
        seeds=whole.photos,
        call=_load_folder,
        around=_colmap,
    ),
    Loader(name="panorama", file="sky.png", seeds=whole.photos, call=_load_panorama),
    Loader(name="recipe", file="recipe.json", seeds=whole.recipes, call=_load_recipe),
    Loader(name="recipe_replay", file="recipe.json", seeds=whole.recipes, call=_replay_recipe),
    Loader(name="journal", file=f"a{SUFFIX}", seeds=whole.journals, call=_find_journals),
    Loader(name="checkpoint", file="run.safetensors", seeds=whole.checkpoints, call=_load_checkpoint),
    Loader(name="preferences", file=FILE_NAME, seeds=whole.preferences, call=_load_preferences),
    Loader(
        name="bookmarks",
        file=beside(Path("scene.ply")).name,
        seeds=whole.bookmarks,
        call=_load_bookmarks,
    ),
    Loader(name="clipboard", file="text", seeds=lambda: [whole.clipboard()], call=_clipboard),
)

BY_NAME = {loader.name: loader for loader in LOADERS}
