"""Illuminance and pictures of a place by Mitsuba 3, beside ours: compare.py FOLDER [SAMPLES [pictures]]."""

import json
import os
import sys

import numpy as np
from PIL import Image

import mitsuba as mi

mi.set_variant("llvm_ad_rgb")

folder = sys.argv[1]
samples = int(sys.argv[2]) if len(sys.argv) > 2 else 4096
# What our panes let through.
PANE = 0.79


def floats(name, columns):
    return np.fromfile(os.path.join(folder, name), np.float32).reshape(-1, columns)


triangles = floats("triangles.f32", 9).reshape(-1, 3, 3)
optics = floats("optics.f32", 3)
place = json.load(open(os.path.join(folder, "place.json")))


def mesh(name, chosen, bsdf, luminance=0.0):
    """One mesh of triangles with a material; vertices are not shared, so that faces stay flat."""
    props = mi.Properties()
    props["bsdf"] = mi.load_dict(bsdf)
    if luminance > 0.0:
        props["emitter"] = mi.load_dict({"type": "area", "radiance": {"type": "rgb", "value": float(luminance)}})
    n = len(chosen)
    made = mi.Mesh(name, 3 * n, n, has_vertex_normals=False, has_vertex_texcoords=False, props=props)
    params = mi.traverse(made)
    params["vertex_positions"] = np.ascontiguousarray(chosen.reshape(-1))
    params["faces"] = np.arange(3 * n, dtype=np.uint32)
    params.update()
    return made


def grey(value):
    return {"type": "rgb", "value": float(value)}


scene = {"type": "scene", "integrator": {"type": "path", "max_depth": -1, "rr_depth": 8}}
glass = optics[:, 2] > 0
# A pane is two facets back to back: one is enough.
single = []
for k in np.flatnonzero(glass):
    normal = np.cross(triangles[k][1] - triangles[k][0], triangles[k][2] - triangles[k][0])
    sides = np.sign(np.round(normal, 6))
    if tuple(sides) > tuple(-sides):
        single.append(k)
if single:
    scene["panes"] = mesh(
        "panes", triangles[single], {"type": "mask", "opacity": 1.0 - PANE, "bsdf": {"type": "diffuse", "reflectance": grey(0.0)}}
    )
groups = {}
# Where there is a sun, the sky is light from everywhere: as a surface it would hide the sun.
sky = (optics[:, 1] == optics[:, 1].max()) & bool(place["sun"])
for k in np.flatnonzero(~glass & ~sky):
    groups.setdefault((float(optics[k, 0]), float(optics[k, 1])), []).append(k)
for number, ((albedo, luminance), chosen) in enumerate(sorted(groups.items())):
    scene[f"m{number}"] = mesh(
        f"m{number}", triangles[chosen], {"type": "diffuse", "reflectance": grey(albedo)}, luminance
    )
if place["sun"]:
    scene["sky"] = {"type": "constant", "radiance": grey(optics[:, 1].max())}
    scene["sun"] = {"type": "directional", "direction": [-v for v in place["sun"]["direction"]], "irradiance": grey(place["sun"]["lux"])}
print(place["place"], len(triangles), "triangles,", len(groups), "materials,", len(single), "panes")
scene = mi.load_dict(scene)

points = floats("points.f32", 8)
found = np.zeros((len(points), 2))
integrator = scene.integrator()
for first in range(0, len(points), 100):
    # A ray straight down onto each point: what it sees is albedo / π times the illuminance, with shadow rays to all lamps there.
    part = points[first : first + 100]
    n = len(part)
    which = np.repeat(np.arange(n), samples)
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(first, n * samples)

    def rays(chosen):
        origin = (part[chosen, 0:3] + 1e-3 * part[chosen, 3:6]).T
        return mi.Ray3f(mi.Point3f(*origin), mi.Vector3f(*(-part[chosen, 3:6].T)))

    light = np.array(integrator.sample(scene, sampler, mi.RayDifferential3f(rays(which)))[0][1])
    hit = scene.ray_intersect(rays(np.arange(n)))
    albedo = np.array(hit.bsdf().eval_diffuse_reflectance(hit)[1])
    light = np.pi * light.reshape(n, samples) / albedo[:, None]
    found[first : first + 100, 0] = light.mean(1)
    found[first : first + 100, 1] = light.std(1) / np.sqrt(samples)
np.save(os.path.join(folder, "mitsuba.npy"), found)

reference, sigma = found.T
for name, ours in [("traced", points[:, 6]), ("baked", points[:, 7])]:
    off = np.abs(ours - reference) / reference
    print(
        f"{name}: off by {100 * np.median(off):.2f} % in the median, 95 % within {100 * np.percentile(off, 95):.1f} %, worst {100 * off.max():.1f} %;"
        f" within 5 %: {100 * np.mean(off < 0.05):.1f} %; mean ratio {ours.sum() / reference.sum():.4f};"
        f" Mitsuba's own noise {100 * np.median(sigma / reference):.2f} % median, {100 * np.max(sigma / reference):.1f} % worst"
    )
    worst = np.argsort(-off)[:8]
    for k in worst:
        print("   ", np.round(points[k, :6], 3), f"ours {ours[k]:.1f} theirs {reference[k]:.1f} ± {sigma[k]:.1f}")

# Pictures from the same places, through a lens without distortion, brought to the mean of a grey card as the cameras are.
for k, view in enumerate(place["views"] if "pictures" in sys.argv else []):
    eye, forward, down = (np.array(view[n]) for n in ("eye", "forward", "down"))
    sensor = mi.load_dict(
        {
            "type": "perspective",
            "fov": 85.0,
            "to_world": mi.ScalarTransform4f().look_at(
                origin=eye.tolist(), target=(eye + forward).tolist(), up=(-down).tolist()
            ),
            "film": {"type": "hdrfilm", "width": 640, "height": 400, "rfilter": {"type": "box"}},
        }
    )
    light = np.array(mi.render(scene, sensor=sensor, spp=16))[:, :, 1]
    low, high = 1e-6, 1e3
    for _ in range(60):
        gain = np.sqrt(low * high)
        low, high = (gain, high) if np.minimum(255 * np.sqrt(gain * light), 300).mean() < 108 else (low, gain)
    Image.fromarray(np.clip(255 * np.sqrt(low * light), 0, 255).astype(np.uint8)).save(os.path.join(folder, f"theirs-{k}.png"))
