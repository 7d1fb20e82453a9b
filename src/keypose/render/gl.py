"""The OpenGL backend: skins every vertex once on the GPU, then draws shadows, surfaces, floor and sky from the result.

Morph targets are summed on the CPU and uploaded: a pose uses a handful of sparse targets, so the sum touches a few
thousand numbers, where a texture of all targets would make every vertex read every target. Only parts whose weights
changed since the last picture are uploaded again.
"""

from __future__ import annotations

import threading
from functools import cache
from importlib.resources import files
from itertools import groupby
from typing import Any

import numpy as np

from keypose import deform
from keypose.arrays import Floats
from keypose.errors import KeyposeError
from keypose.model import SkinningMethod
from keypose.render.camera import SHADOW_SIZE, View
from keypose.render.frame import pack_frame
from keypose.render.settings import Picture, RenderSettings
from keypose.render.stage import Moment, Stage
from keypose.render.surfaces import Surface, surfaces

_MASK_SIZE, _SOFT_SIZE, _CONTACT_SIZE = 256, 128, 128
_MAX_SAMPLES = 1 << 27  # of one picture: about 1 GiB of colour and depth
_PALETTE_JOINTS = 64  # per line of the palette texture, three texels each
_SRGB8_ALPHA8 = 0x8C43
_SCREENS = ("mask", "blur", "sky", "reduce", "ground", "floor_depth", "shade", "still")  # drawn without buffers
# programs whose two shader files are not named like the program
_STAGES = {name: ("screen", name) for name in ("mask", "blur", "sky", "reduce", "still")} | {
    "floor_depth": ("ground", "depth_only")
}
_thread = threading.local()


class NoDriverError(KeyposeError):
    """There is no usable OpenGL driver on this machine."""


def context() -> Any:
    """This thread's OpenGL context; raises `NoDriverError` where there is no driver."""
    held = getattr(_thread, "context", None)
    if held is not None:
        return held
    import moderngl

    reasons: list[str] = []
    choices: tuple[dict[str, Any], ...] = ({"backend": "egl"}, {})
    for options in choices:
        try:
            made = moderngl.create_context(require=330, standalone=True, **options)
        except Exception as reason:  # moderngl raises bare Exception, glcontext ImportError, ...
            reasons.append(str(reason))
            continue
        made.gc_mode = "context_gc"
        _thread.context = made
        return made
    raise NoDriverError(
        f"no OpenGL driver: {'; '.join(reasons)}; use backend='cpu', or install one (Debian: libegl1 libgl1-mesa-dri)"
    )


@cache
def _source(name: str) -> str:
    return (files("keypose.render") / "shaders" / name).read_text("utf-8")


def _program(name: str) -> Any:
    """A compiled program of this thread's context."""
    programs = _thread.__dict__.setdefault("programs", {})
    if name in programs:
        return programs[name]
    ctx = context()
    head = "#version 330 core\n" + _source("frame.glsl")
    if name.startswith("skin"):
        define = "#define EIGHT\n" if name == "skin8" else ""
        made = ctx.program(
            vertex_shader="#version 330 core\n" + define + _source("skin.vert"),
            varyings=["out_position", "out_normal"],
        )
    else:
        vertex, fragment = _STAGES.get(name, (name, name))
        made = ctx.program(
            vertex_shader=head + _source(f"{vertex}.vert"), fragment_shader=head + _source(f"{fragment}.frag")
        )
        if "Frame" in made:
            made["Frame"].binding = 0
    programs[name] = made
    return made


class _Mesh:
    """The buffers of one surface."""

    def __init__(self, surface: Surface, first: int, white: Any) -> None:
        ctx = context()
        mesh = surface.part.mesh
        count = mesh.vertex_count
        self.surface, self.first, self.count = surface, first, count
        rest = np.zeros((count, 6), np.float32)
        rest[:, :3] = mesh.positions
        self.flat = mesh.normals is None
        if mesh.normals is not None:
            rest[:, 3:] = mesh.normals
        self.rest = ctx.buffer(rest)
        self.weights: Floats | None = None  # morph weights that are in the rest buffer now
        self.skinned = ctx.buffer(reserve=count * 24)
        look = np.ones((count, 6), np.float32)
        look[:, :2] = 0 if mesh.uvs is None else mesh.uvs
        if mesh.colors is not None:
            look[:, 2:] = mesh.colors
        looks = ctx.buffer(look)
        index = ctx.buffer(np.ascontiguousarray(mesh.triangles, np.int32))
        eight = surface.joints.shape[1] == 8
        bound: list[tuple[Any, ...]] = [(self.rest, "3f 3f", "in_position", "in_normal")]
        bound.append((ctx.buffer(np.ascontiguousarray(surface.joints[:, :4])), "4i", "in_joints"))
        bound.append((ctx.buffer(np.ascontiguousarray(surface.weights[:, :4])), "4f", "in_weights"))
        if eight:
            bound.append((ctx.buffer(np.ascontiguousarray(surface.joints[:, 4:])), "4i", "in_joints_more"))
            bound.append((ctx.buffer(np.ascontiguousarray(surface.weights[:, 4:])), "4f", "in_weights_more"))
        self.skin_program = _program("skin8" if eight else "skin4")
        self.skin = ctx.vertex_array(self.skin_program, bound)
        place = (self.skinned, "3f 12x", "in_position")
        self.depth = ctx.vertex_array(_program("depth"), [place, (looks, "2f 16x", "in_uv")], index)
        self.contact = ctx.vertex_array(_program("contact"), [place], index)
        self.draw = ctx.vertex_array(
            _program("surface"),
            [(self.skinned, "3f 3f", "in_position", "in_normal"), (looks, "2f 4f", "in_uv", "in_color")],
            index,
        )
        self.texture = white if surface.texture is None else _texture(surface.texture)

    def morph(self, moment: Moment) -> None:
        """Upload the morphed rest shape if the weights have changed."""
        morphs = self.surface.part.morphs
        if morphs is None or not len(morphs.names):
            return
        weights = self.surface.morph_weights(moment)
        if self.weights is not None and np.array_equal(weights, self.weights):
            return
        rows = np.zeros((self.count, 6), np.float32)
        mesh = self.surface.part.mesh
        if mesh.normals is None:
            rows[:, :3] = deform.morph(mesh, morphs, weights)
        else:
            rows[:, :3], rows[:, 3:] = deform.morph(mesh, morphs, weights, with_normals=True)
        self.rest.write(rows)
        self.weights = weights


def _deformed(surface: Surface, moment: Moment) -> Floats:
    """World positions and normals (V, 6) of a part that the shader cannot skin."""
    part, rows = surface.part, np.zeros((surface.part.mesh.vertex_count, 6), np.float32)
    matrices, weights = moment.matrices[surface.drawn], moment.morph_weights[surface.drawn]
    if part.mesh.normals is None:
        rows[:, :3] = deform.deform_part(surface.character, part, matrices, weights)
    else:
        rows[:, :3], rows[:, 3:] = deform.deform_part(surface.character, part, matrices, weights, with_normals=True)
    return rows


def _texture(pixels: Picture) -> Any:
    ctx = context()
    height, width = pixels.shape[:2]
    made = ctx.texture((width, height), 4, np.ascontiguousarray(pixels), internal_format=_SRGB8_ALPHA8)
    made.build_mipmaps()
    made.filter = (ctx.LINEAR_MIPMAP_LINEAR, ctx.LINEAR)
    made.anisotropy = 4.0
    return made


class GlRenderer:
    """Draws moments of one stage into pictures of one size; use it from the thread that made it."""

    name = "gl"

    def __init__(self, stage: Stage, settings: RenderSettings, supersample: int) -> None:
        ctx = self.ctx = context()
        self.settings = settings
        self.block, self.samples = _sampling(
            settings, supersample, int(ctx.info["GL_MAX_TEXTURE_SIZE"]), ctx.max_samples
        )
        self.size = (settings.width * self.block, settings.height * self.block)
        white = _texture(np.full((1, 1, 4), 255, np.uint8))
        self.meshes: list[_Mesh] = []
        joints = 0
        for surface in surfaces(stage):
            self.meshes.append(_Mesh(surface, joints, white))
            joints += len(surface.palette)
        lines = max(1, -(-joints // _PALETTE_JOINTS))
        self.palette_rows = np.zeros((lines * _PALETTE_JOINTS, 3, 4), np.float32)
        self.palette = ctx.texture((3 * _PALETTE_JOINTS, lines), 4, dtype="f4")
        self.palette.filter = (ctx.NEAREST, ctx.NEAREST)
        self.frame = ctx.buffer(reserve=34 * 16)
        self._make_targets()

    def _make_targets(self) -> None:
        ctx, samples = self.ctx, self.samples
        self.picture = ctx.texture(self.size, 4)
        self.still_picture = ctx.texture(self.size, 4)
        self.still = ctx.framebuffer([self.still_picture])
        self.kept_key = self.last_key = b""
        self.has_floor = self.settings.ground
        self.resolved = ctx.framebuffer([self.picture])
        self.drawing = ctx.framebuffer(
            [ctx.renderbuffer(self.size, 4, samples=samples)], ctx.depth_renderbuffer(self.size, samples=samples)
        )
        self.final = ctx.framebuffer([ctx.renderbuffer((self.settings.width, self.settings.height), 4)])
        self.depth_map = ctx.depth_texture((SHADOW_SIZE, SHADOW_SIZE))
        self.depth_target = ctx.framebuffer([], self.depth_map)
        self.compared = ctx.sampler(repeat_x=False, repeat_y=False, filter=(ctx.LINEAR, ctx.LINEAR), compare_func="<=")
        self.fetched = ctx.sampler(repeat_x=False, repeat_y=False, filter=(ctx.NEAREST, ctx.NEAREST))

        def plane(size: int) -> tuple[Any, Any]:
            texture = ctx.texture((size, size), 2, dtype="f1")
            texture.repeat_x = texture.repeat_y = False
            return texture, ctx.framebuffer([texture])

        self.crisp = plane(_MASK_SIZE)
        self.soft = (plane(_SOFT_SIZE), plane(_SOFT_SIZE))
        self.near_floor = (plane(_CONTACT_SIZE), plane(_CONTACT_SIZE))
        self.contact_depth = ctx.framebuffer(
            [self.near_floor[0][0]], ctx.depth_renderbuffer((_CONTACT_SIZE, _CONTACT_SIZE))
        )
        self.screens = {n: ctx.vertex_array(_program(n), []) for n in _SCREENS}

    def draw(self, moment: Moment, view: View) -> Picture:
        """One picture, (H, W, 4) uint8, straight alpha."""
        ctx = self.ctx
        self.frame.write(pack_frame(view, self.settings, *self.size))
        self.frame.bind_to_uniform_block(0)
        self.skin(moment)
        if self.settings.shadows:
            self._shadows()
        self.drawing.use()
        self.drawing.clear(0, 0, 0, 0)
        ctx.disable(ctx.BLEND)
        ctx.enable(ctx.DEPTH_TEST)
        ctx.depth_func = "<="
        ghosts = [m for m in self.meshes if m.surface.cast.ghost > 0]
        solid = [m for m in self.meshes if not m.surface.blended]
        glass = [m for m in self.meshes if m.surface.blended and m.surface.cast.ghost == 0]
        self.has_floor = self.settings.ground and view.above
        standing = self._stands(view)
        if standing or ghosts:
            self._backdrop(standing)
        for _, parts in groupby(ghosts, key=lambda m: m.surface.drawn):
            self._ghost(list(parts), moment)
        if ghosts:  # they are behind the subject, whatever the depth: only the floor's depth stays
            self._hide()
            self.drawing.clear(depth=1.0)
            self._floor("floor_depth")
            self._show()
        for mesh in solid:
            self._surface(mesh, moment)
        if not (standing or ghosts):
            self._backdrop(False)
        self._shade()
        self._blend()
        for mesh in self._far_to_near(glass, moment, view):
            self._surface(mesh, moment)
        ctx.disable(ctx.BLEND)
        ctx.copy_framebuffer(self.resolved, self.drawing)
        size = (self.settings.height, self.settings.width, 4)
        if self.block > 1:
            self.final.use()
            ctx.disable(ctx.DEPTH_TEST | ctx.CULL_FACE)
            self.picture.use(0)
            reduce = _program("reduce")
            reduce["source"], reduce["block"] = 0, self.block
            self.screens["reduce"].render(ctx.TRIANGLES, 3)
        source = self.final if self.block > 1 else self.resolved
        # OpenGL's rows run upwards
        picture = np.frombuffer(source.read(components=4, alignment=1), np.uint8).reshape(size)[::-1]
        return _straight(picture) if self.settings.transparent else np.ascontiguousarray(picture)

    def skin(self, moment: Moment) -> None:
        """Skin all meshes; their buffers then hold world positions and normals, six floats per vertex."""
        for mesh in self.meshes:
            mesh.morph(moment)
            matrices = mesh.surface.palette_matrices(moment)
            self.palette_rows[mesh.first : mesh.first + len(matrices)] = matrices[:, :3]
        self.palette.write(self.palette_rows)
        self.resolved.use()  # without a screen there is no default target, and nothing runs without a target
        self.palette.use(0)
        for mesh in self.meshes:
            skin = mesh.surface.part.skin
            if skin is not None and skin.method is not SkinningMethod.LINEAR:
                mesh.skinned.write(_deformed(mesh.surface, moment))
                continue
            mesh.skin_program["palette"], mesh.skin_program["first"] = 0, mesh.first
            mesh.skin.transform(mesh.skinned, self.ctx.POINTS, mesh.count)

    def read_skinned(self) -> list[tuple[Surface, Floats, Floats]]:
        """Each surface with its world positions and normals (V, 3) as the GPU computed them last."""
        found: list[tuple[Surface, Floats, Floats]] = []
        for mesh in self.meshes:
            rows = np.frombuffer(mesh.skinned.read(), np.float32).reshape(-1, 6)
            found.append((mesh.surface, rows[:, :3], rows[:, 3:]))
        return found

    def close(self) -> None:
        """Give the GPU's memory back."""
        self.meshes.clear()
        for name in list(self.__dict__):
            if name not in ("ctx", "settings"):
                delattr(self, name)
        self.ctx.gc()

    def _shadows(self) -> None:
        ctx = self.ctx
        ctx.disable(ctx.BLEND | ctx.CULL_FACE)
        ctx.enable(ctx.DEPTH_TEST)
        ctx.depth_func = "<"
        self.depth_target.use()
        self.depth_target.clear()
        depth = _program("depth")
        casting = [m for m in self.meshes if m.surface.casts_shadow]
        for mesh in casting:
            material = mesh.surface.material
            mesh.texture.use(0)
            depth["base_texture"] = 0
            depth["base_color"], depth["cutoff"] = material.base_color, material.alpha_cutoff
            depth["masked"] = int(material.alpha_mode == "MASK")
            mesh.depth.render()
        if not self.settings.ground:
            return
        self.contact_depth.use()
        self.contact_depth.clear()
        for mesh in casting:
            mesh.contact.render()
        ctx.disable(ctx.DEPTH_TEST)
        mask = _program("mask")
        mask["depth_map"], mask["block"] = 0, SHADOW_SIZE // _MASK_SIZE
        self.depth_map.use(0)
        self.fetched.use(0)
        self.crisp[1].use()
        self.screens["mask"].render(ctx.TRIANGLES, 3)
        self.fetched.clear(0)
        self._blur(self.crisp, self.soft[1], self.soft[0], 8, 3.4)
        self._blur(self.near_floor[0], self.near_floor[1], self.near_floor[0], 7, 3.0)

    def _blur(
        self, source: tuple[Any, Any], between: tuple[Any, Any], result: tuple[Any, Any], taps: int, sigma: float
    ) -> None:
        blur, kernel = _program("blur"), blur_kernel(taps, sigma)
        blur["source"], blur["taps"] = 0, len(kernel)
        blur["kernel"].write(np.pad(kernel, ((0, 8 - len(kernel)), (0, 0))).astype(np.float32))
        step = 1 / between[0].width
        for texture, target, stride in ((source[0], between[1], (step, 0.0)), (between[0], result[1], (0.0, step))):
            texture.use(0)
            blur["stride"] = stride
            target.use()
            self.screens["blur"].render(self.ctx.TRIANGLES, 3)

    def _surface(self, mesh: _Mesh, moment: Moment) -> None:
        ctx, surface, program = self.ctx, mesh.surface, _program("surface")
        material, cast = surface.material, surface.cast
        if material.double_sided or cast.ghost > 0:
            ctx.disable(ctx.CULL_FACE)
        else:
            ctx.enable(ctx.CULL_FACE)
        ctx.front_face = "cw" if surface.mirrored(moment) else "ccw"
        mesh.texture.use(0)
        self.depth_map.use(1)
        self.compared.use(1)
        cutoff = {"MASK": material.alpha_cutoff, "BLEND": -1.0}.get(material.alpha_mode, 0.0)
        alpha = 1.0 if material.alpha_mode == "OPAQUE" else material.base_color[3]
        opacity = cast.ghost if cast.ghost > 0 else 1.0
        program["base_texture"], program["depth_map"] = 0, 1
        program["base_color"] = (*material.base_color[:3], alpha)
        program["emissive"] = material.emissive
        program["surface"] = (material.metallic, material.roughness, cutoff, opacity)
        program["flags"] = (int(material.unlit), int(mesh.flat), int(cast.overlay), int(cast.ghost > 0))
        theme = self.settings.colors
        program["tint"] = (*(theme.bone_left if cast.delay_s > 0 else theme.bone_right), 0.6)
        program["overlay"] = float(cast.overlay)
        mesh.draw.render()
        self.compared.clear(1)

    def _ghost(self, parts: list[_Mesh], moment: Moment) -> None:
        # only a ghost's nearest surface shows: the depth of all its parts goes first
        self._hide()
        for mesh in parts:
            self._surface(mesh, moment)
        self._show()
        self._blend()
        for mesh in parts:
            self._surface(mesh, moment)
        self.ctx.disable(self.ctx.BLEND)

    def _hide(self) -> None:
        self.drawing.color_mask = (False, False, False, False)
        self.drawing.use()

    def _show(self) -> None:
        self.drawing.color_mask = (True, True, True, True)
        self.drawing.use()

    def _blend(self) -> None:
        self.ctx.enable(self.ctx.BLEND)
        self.ctx.blend_func = self.ctx.ONE, self.ctx.ONE_MINUS_SRC_ALPHA

    def _far_to_near(self, meshes: list[_Mesh], moment: Moment, view: View) -> list[_Mesh]:
        def depth(mesh: _Mesh) -> float:
            matrix = mesh.surface.palette_matrices(moment)[0]
            middle = np.asarray(mesh.surface.part.mesh.positions).mean(axis=0)
            return float((matrix[:3, :3] @ middle + matrix[:3, 3] - view.eye) @ view.forward)

        return sorted(meshes, key=depth, reverse=True)

    def _backdrop(self, standing: bool) -> None:
        """Floor and sky behind what is drawn already, or from the picture of them that was kept."""
        ctx = self.ctx
        if standing:
            ctx.disable(ctx.DEPTH_TEST | ctx.CULL_FACE)
            self.still_picture.use(0)
            _program("still")["source"] = 0
            self.screens["still"].render(ctx.TRIANGLES, 3)
            ctx.enable(ctx.DEPTH_TEST)
            self._hide()
            self._floor("floor_depth")
            self._show()
        elif self.settings.transparent:
            self._hide()
            self._floor("floor_depth")
            self._show()
        else:
            self._floor("ground")
            self.screens["sky"].render(ctx.TRIANGLES, 3)

    def _floor(self, program: str) -> None:
        self.ctx.disable(self.ctx.CULL_FACE)
        if self.has_floor:
            self.screens[program].render(self.ctx.TRIANGLE_STRIP, 4)

    def _shade(self) -> None:
        """The shadow on the floor."""
        if not (self.settings.shadows and self.has_floor):
            return
        ctx, shade = self.ctx, _program("shade")
        shade["near_cover"], shade["far_cover"], shade["contact"] = 0, 1, 2
        self.crisp[0].use(0)
        self.soft[0][0].use(1)
        self.near_floor[0][0].use(2)
        ctx.disable(ctx.CULL_FACE)
        self._blend()
        self.screens["shade"].render(ctx.TRIANGLE_STRIP, 4)
        ctx.disable(ctx.BLEND)

    def _stands(self, view: View) -> bool:
        """Whether the camera has not moved since the last picture; the first time, its backdrop is drawn and kept."""
        key = np.concatenate([view.clip_from_world.ravel(), view.focus]).tobytes()
        if self.settings.transparent:
            return False
        if key == self.kept_key:
            return True
        if key != self.last_key:
            self.last_key = key
            return False
        self.kept_key = key
        self.still.use()
        self.ctx.disable(self.ctx.DEPTH_TEST)
        self.screens["sky"].render(self.ctx.TRIANGLES, 3)
        self._floor("ground")
        self.ctx.enable(self.ctx.DEPTH_TEST)
        self.drawing.use()
        return True


def _sampling(settings: RenderSettings, supersample: int, max_side: int, max_samples: int) -> tuple[int, int]:
    """How many times larger the picture is drawn, and samples per pixel of that, within what the driver can hold."""
    block = max(1, min(supersample, max_side // max(settings.width, settings.height)))
    samples = min(8 if block == 1 else 4, max_samples)
    pixels = settings.width * settings.height
    while block > 1 and pixels * block**2 * samples > _MAX_SAMPLES:
        block -= 1
    while samples > 1 and pixels * block**2 * samples > _MAX_SAMPLES:
        samples //= 2
    return block, samples


def blur_kernel(taps: int, sigma: float) -> Floats:
    """Offsets and weights of a Gaussian of 2 taps + 1 texels whose texels are read in pairs, (1 + taps / 2, 2)."""
    weights = np.exp(-0.5 * (np.arange(taps + 1) / sigma) ** 2)
    weights /= weights[0] + 2 * weights[1:].sum()
    rows = [(0.0, float(weights[0]))]
    for i in range(1, taps + 1, 2):
        pair = weights[i : i + 2]
        rows.append((float((pair * np.arange(i, i + len(pair))).sum() / pair.sum()), float(pair.sum())))
    return np.array(rows)


def _straight(picture: Picture) -> Picture:
    """Straight alpha from premultiplied."""
    alpha = picture[..., 3:].astype(np.float32)
    colors = picture[..., :3] * (255 / np.maximum(alpha, 1))
    return np.concatenate([np.clip(np.rint(colors), 0, 255), alpha], axis=-1).astype(np.uint8)
