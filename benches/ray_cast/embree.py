"""Rays per second of Embree (PyPI embreex) on what `throughput --export FOLDER` wrote, and how far the distances agree."""

import os
import sys
import time

import numpy as np
from embreex import rtcore_scene
from embreex.mesh_construction import TriangleMesh


def load(folder, name, columns):
    values = np.fromfile(os.path.join(folder, name), dtype="<f4")
    return values.reshape(-1, columns) if columns > 1 else values


folder = sys.argv[1]
triangles = load(folder, "triangles.f32", 9).reshape(-1, 3, 3)
origins = load(folder, "origins.f32", 3)
directions = load(folder, "directions.f32", 3)
own = load(folder, "distances.f32", 1)

scene = rtcore_scene.EmbreeScene()
TriangleMesh(scene, np.ascontiguousarray(triangles, dtype=np.float32))
scene.run(origins[:1000], directions[:1000], query="DISTANCE")
best = {}
for query in ["INTERSECT", "DISTANCE"]:
    for _ in range(5):
        began = time.process_time()
        result = scene.run(origins, directions, query=query)
        spent = time.process_time() - began
        best[query] = max(best.get(query, 0.0), len(origins) / spent / 1e6)
print(f"{len(triangles)} triangles, {len(origins)} rays")
for query, rate in best.items():
    print(f"embree, {query.lower()}: {rate:.2f} M rays/s of CPU time")
hit = (own > 0) & (result < 1e30)
off = np.abs(result[hit] - own[hit])
print(f"both hit {hit.mean():.4f} of the rays; within 1 mm: {(off < 1e-3).mean():.5f}")
