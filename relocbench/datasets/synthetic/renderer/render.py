"""The renderer: images of a district in a condition, with exact depth, normals and objects."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from relocbench.arrays import Array, Bytes, Floats, Image, Mask
from relocbench.datasets.synthetic.camera.drops import add_lens_drops
from relocbench.datasets.synthetic.camera.motion_blur import motion_blur
from relocbench.datasets.synthetic.camera.photograph import exposure_ev, grey_levels, through_lens
from relocbench.datasets.synthetic.camera.rectified import RadialLens
from relocbench.datasets.synthetic.camera.rolling_shutter import Readout, rolling
from relocbench.datasets.synthetic.camera.shot import Shot
from relocbench.datasets.synthetic.conditions.condition import Factors
from relocbench.datasets.synthetic.renderer import lamps as lighting
from relocbench.datasets.synthetic.renderer import reflections, shading, shadows, surfaces
from relocbench.datasets.synthetic.renderer import samples as sampling
from relocbench.datasets.synthetic.renderer.edges import (
    blend_edges,
    edge_pixels,
    known_colours,
    neighbours_seen,
)
from relocbench.datasets.synthetic.renderer.lamps import Beam
from relocbench.datasets.synthetic.renderer.materials import make_looks
from relocbench.datasets.synthetic.renderer.response import apply_response, exposure_gain
from relocbench.datasets.synthetic.renderer.room import Room
from relocbench.datasets.synthetic.renderer.samples import PIXEL_OFFSETS, Samples, View, direct_samples
from relocbench.datasets.synthetic.renderer.sky import Sky, make_sky
from relocbench.datasets.synthetic.renderer.skylight import MovingSkylight, Skylight, make_skylight
from relocbench.datasets.synthetic.renderer.surfaces import Hits, Setting
from relocbench.datasets.synthetic.renderer.textures import bake
from relocbench.datasets.synthetic.renderer.weather import draw_precipitation, falling_extinction
from relocbench.datasets.synthetic.town.mesh import Mesh
from relocbench.datasets.synthetic.town.raycast import NOTHING, Scene, ScenePair
from relocbench.errors import ConfigError
from relocbench.geometry import Camera

_LEAST_MIRROR = 0.03
"""specular reflectance below which no ray is cast"""
_LAMP_AT = 0.95
"""ray parameter at which shadow rays to a lamp end, before its own glass"""


@dataclass(frozen=True, eq=False)
class Frame:
    """One image with its ground truth, which is that of the ray through each pixel's centre."""

    rgb: Image
    """(H, W, 3)"""
    depth: Floats
    """(H, W) metres along z, 0 for the sky"""
    normal: Floats
    """(H, W, 3) in the world, towards the camera; 0 for the sky"""
    instance: NDArray[np.uint32]
    """(H, W), 0 for the ground and the sky"""
    semantic: Bytes
    """(H, W) :class:`Semantic`"""


@dataclass(frozen=True, eq=False)
class Surroundings:
    """The parts of a scene that do not depend on what moves."""

    sky: Sky
    skylight: Skylight


class Renderer:
    """Renders a mesh under the factors.

    Args:
        mesh: world frame, z up.
        factors: weather, time of day and camera response.
        lamps: (L, 3) positions of street lamps, metres.
        seed: seed of patterns, colours and clouds.
        surroundings: those of the same town, if available; computing them takes longer than rendering an image.
    """

    def __init__(
        self,
        mesh: Mesh,
        factors: Factors,
        lamps: NDArray[np.floating],
        seed: int,
        surroundings: Surroundings | None = None,
    ) -> None:
        self.factors = factors
        scene = Scene(mesh)
        self._scene: Scene | ScenePair = scene
        self._still = scene
        self._room = Room(mesh)
        self._patterns = bake(seed)
        self._looks = make_looks(factors.leaf_colour)
        if surroundings is None:
            self._sky, self._skylight = make_sky(factors, seed), make_skylight(mesh, scene)
        else:
            self._sky, self._skylight = surroundings.sky, surroundings.skylight
        self._with_moving = MovingSkylight(self._skylight)
        self._lamps = lighting.make_lamps(lamps)
        self._by_lamp = not self._sky.sun.any()
        extinction = factors.fog_density + falling_extinction(factors.rain_mm_h, factors.snowfall_mm_h)
        night = float(np.clip((3.0 - factors.sun_elevation_deg) / 9.0, 0, 1))
        self._setting = Setting(
            factors.wetness,
            factors.puddles,
            factors.snow_cover,
            extinction,
            factors.street_lamps,
            factors.headlights,
            night,
            seed & 0xFFFFFFFF,
        )

    @property
    def surroundings(self) -> Surroundings:
        """What renderers of the same town can reuse."""
        return Surroundings(self._sky, self._skylight)

    def with_moving(self, mesh: Mesh) -> Renderer:
        """A renderer of the same scene with what moves at one moment.

        It takes the place of the one that was made before: all have one :class:`Room` and one :class:`MovingSkylight`.
        """
        other = copy(self)
        self._room.put(mesh)
        scene = ScenePair(self._still, self._room.triangles, mesh)
        other._scene, other._skylight = scene, self._with_moving.put(mesh, scene.second)
        return other

    def render(
        self,
        camera: Camera,
        T_world_cam: Array,
        frame_seed: int,
        T_world_vehicle: Array | None = None,
        shot: Shot | None = None,
        distortion: float = 0.0,
        readout: Readout | None = None,
    ) -> Frame:
        """Render the image of a pinhole camera; the same arguments give the same bytes.

        Args:
            T_world_cam: (4, 4).
            frame_seed: seed of what differs between images: noise, falling rain and snow, drops on the lens.
            T_world_vehicle: (4, 4) pose of the car with the headlights; default: they are below the camera and point
                where it looks.
            shot: the drive's own camera; default: the ideal camera of the factors.
            distortion: of the lens by which the image is taken before it is rectified; see :class:`RadialLens`.
            readout: of a rolling shutter. The image alone has it; the truth is that of a global shutter.

        Raises:
            ConfigError: the camera is not a pinhole camera.
        """
        if camera.model != "pinhole":
            raise ConfigError(f"images are rendered with a pinhole camera, got '{camera.model}'")
        pose = np.asarray(T_world_cam, dtype=np.float64)
        lens = RadialLens(camera, distortion) if distortion else None
        taken = camera if lens is None else lens.taken
        view = _view(taken, pose, 0.0 if lens is None else lens.bend)
        beam = _headlights(pose if T_world_vehicle is None else np.asarray(T_world_vehicle), T_world_vehicle is None)
        shape = camera.height, camera.width
        u = np.tile(np.arange(camera.width, dtype=np.float32), camera.height)
        v = np.repeat(np.arange(camera.height, dtype=np.float32), camera.width)
        samples = self._trace(view, direct_samples(u, v))
        hits = self._surfaces(view, samples)
        light, _ = self._light(view, beam, samples, hits, camera.width)
        light = self._smooth_edges(view, beam, samples, hits, light, camera.width)

        image = light.reshape(*shape, 3)
        depth = hits.depth.astype(np.float32).reshape(shape)
        rgb = self._develop(image, depth, taken, pose, frame_seed, shot, readout)
        if lens is not None:
            # The truth is that of the pinhole camera's own rays, since depth cannot be interpolated.
            rgb = lens.rectified(rgb)
            view = _view(camera, pose)
            samples = self._trace(view, direct_samples(u, v))
            hits = self._surfaces(view, samples)
            depth = hits.depth.astype(np.float32).reshape(shape)
        instance, semantic = surfaces.objects(self._room.geometry, samples.triangle)
        return Frame(rgb, depth, hits.normal.reshape(*shape, 3), instance.reshape(shape), semantic.reshape(shape))

    def _trace(self, view: View, samples: Samples) -> Samples:
        """The samples with the triangles that their rays hit."""
        return samples._replace(triangle=self._scene.closest(sampling.make_rays(view, samples)))

    def _surfaces(self, view: View, samples: Samples) -> Hits:
        return surfaces.surfaces(view, self._room.geometry, self._patterns, self._looks, self._setting, samples)

    def _light(self, view: View, beam: Beam, samples: Samples, hits: Hits, width: int = 0) -> tuple[Floats, Floats]:
        """Radiance (N, 3) and share of unshadowed light (N,); ``width`` is given if the samples are a whole image."""
        lit = self._lit(view, hits, width)
        reflected = np.full((len(lit), 3), -1, dtype=np.float32)
        if not samples.before.any():
            self._reflect(view, beam, samples, hits, reflected, width)
        scene = self._room.geometry, self._setting, self._sky, self._skylight, self._lamps
        return shading.radiance(view, *scene, beam, samples, hits, lit, reflected), lit

    def _lit(self, view: View, hits: Hits, width: int) -> Floats:
        lit = np.ones(len(hits.depth), dtype=np.float32)
        if self._by_lamp and not self._setting.lamps_on:
            return lit
        if width:
            self._cast_shadows(hits, shadows.chessboard(len(lit), width), lit)
            self._cast_shadows(hits, shadows.interpolate_chessboard(hits, lit, width), lit)
        else:
            self._cast_shadows(hits, np.ones(len(lit), dtype=np.bool_), lit)
        if width and not self._by_lamp:
            rims, rays = shadows.penumbra_rays(view, hits, lit, width, self._sky.to_sun)
            lit[rims] = 1.0 - self._scene.occluded(rays).reshape(-1, 4).mean(axis=1, dtype=np.float32)
        return lit

    def _cast_shadows(self, hits: Hits, asked: Mask, lit: Floats) -> None:
        index, rays = shadows.shadow_rays(hits, asked, self._sky.to_sun, self._by_lamp, self._lamps)
        lit[index] = 1.0 - self._scene.occluded(rays, _LAMP_AT if self._by_lamp else np.inf)

    def _reflect(self, view: View, beam: Beam, samples: Samples, hits: Hits, reflected: Floats, width: int) -> None:
        """Compute the light (N, 3) that specular samples reflect, into ``reflected``."""
        casts = surfaces.casts_reflection(self._room.geometry, samples, hits, _LEAST_MIRROR)
        interpolated = reflections.interpolated_pixels(casts, hits, width) if width else np.zeros(0, dtype=np.int64)
        mirrors = casts.copy()
        casts[interpolated] = False
        index = np.flatnonzero(casts)
        if len(index) == 0:
            return
        mirrored = Samples(
            samples.u[index],
            samples.v[index],
            hits.depth[index].astype(np.float32),
            hits.normal[index],
            np.full(len(index), NOTHING, np.uint32),
        )
        mirrored = self._trace(view, mirrored)
        colour, _ = self._light(view, beam, mirrored, self._surfaces(view, mirrored))
        reflected[index] = colour
        if width:
            reflections.fill(reflected, interpolated, width)
            reflections.roughen(reflected, mirrors, hits.sharpness, width)

    def _smooth_edges(self, view: View, beam: Beam, samples: Samples, hits: Hits, light: Floats, width: int) -> Floats:
        """Make each edge pixel the mean of five samples. Only samples of surfaces not seen nearby are shaded."""
        edges = edge_pixels(self._room.names, samples.triangle, hits, light, width)
        if len(edges) == 0:
            return light
        known = neighbours_seen(view, self._room.geometry, edges, samples.triangle, width)
        # Samples that hit no neighbour's triangle, but sky or a triangle smaller than a pixel, need a ray.
        cast = np.flatnonzero(known < 0)
        pixels, offsets = edges[cast // 4], PIXEL_OFFSETS[cast % 4]
        finer = self._trace(view, direct_samples(samples.u[pixels] + offsets[:, 0], samples.v[pixels] + offsets[:, 1]))
        known[cast] = known_colours(
            self._room.geometry, self._room.names, pixels, finer.triangle, samples.triangle, hits, width
        )
        unknown = known[cast] < 0
        index = np.zeros(len(known), dtype=np.int64)
        index[cast[unknown]] = np.arange(np.count_nonzero(unknown))
        rest = direct_samples(finer.u[unknown], finer.v[unknown])._replace(triangle=finer.triangle[unknown])
        own, _ = self._light(view, beam, rest, self._surfaces(view, rest))
        return blend_edges(light, edges, known, own, index)

    def _develop(
        self,
        image: Floats,
        depth: Floats,
        camera: Camera,
        pose: Array,
        frame_seed: int,
        shot: Shot | None,
        readout: Readout | None,
    ) -> Image:
        """Apply the weather between scene and lens, then the camera, each with its own random stream.

        The weather is drawn into light that is blurred already, since its streaks are those of an exposure.
        """
        f = self.factors
        falling, drops, noise = (np.random.default_rng([frame_seed & (2**64 - 1), k]) for k in range(3))
        if readout is not None:
            image, depth = rolling(image, depth, camera, readout)
        if shot is not None:
            image = motion_blur(image, depth, camera, shot.twist, shot.imaging.exposure_ms / 1e3)
        if f.rain_mm_h > 0 or f.snowfall_mm_h > 0:
            down = pose[2, :2] * -1.0
            size = float(np.hypot(*down))
            down = down / size if size > 1e-6 else np.array([0.0, 1.0])
            particles = np.asarray(0.75 * self._sky.ambient + 0.35 * self._sky.horizon, dtype=np.float32)
            focal, fall = (camera.fx, camera.fy), (float(down[0]), float(down[1]))
            draw_precipitation(image, depth, focal, fall, f.rain_mm_h, f.snowfall_mm_h, particles, falling)
        if f.lens_drops > 0:
            image = add_lens_drops(image, f.lens_drops, drops)
        if shot is None:
            return apply_response(image, f, noise)
        image = through_lens(image, shot)
        gain = exposure_gain(image, f) * 2.0 ** exposure_ev(shot)
        return grey_levels(image * np.float32(gain), shot, noise)


def _view(camera: Camera, pose: Array, bend: float = 0.0) -> View:
    return View(pose[:3, 3].copy(), pose[:3, :3].copy(), camera.fx, camera.fy, camera.cx, camera.cy, bend)


def _headlights(pose: Array, of_camera: bool) -> Beam:
    """Headlights at the front of the vehicle or, for a camera's pose, below the camera in its viewing direction."""
    forward = pose[:3, 2] if of_camera else pose[:3, 0]
    flat = np.array([forward[0], forward[1], 0.0])
    flat /= max(float(np.linalg.norm(flat)), 1e-9)
    origin = pose[:3, 3] + (np.array([0, 0, -0.9]) if of_camera else 1.9 * flat + np.array([0, 0, 0.65]))
    return Beam(origin.astype(np.float32), flat.astype(np.float32))
