"""Peer of `cargo run --release -p lsfb-problems --example solve -- pose-graph`: GTSAM's LM on a g2o file, one thread, CPU time.

    python3 -m venv V && V/bin/pip install gtsam "numpy<2.3"; V/bin/python gtsam_pose_graph.py FILE.g2o [REPEATS]
"""
import os
import sys
import time

os.environ["OMP_NUM_THREADS"] = os.environ["TBB_NUM_THREADS"] = "1"
import gtsam

graph, values = gtsam.readG2o(sys.argv[1], True)
first = min(values.keys())
graph.push_back(gtsam.PriorFactorPose3(first, values.atPose3(first), gtsam.noiseModel.Isotropic.Sigma(6, 1e-3)))
times = []
for _ in range(int(sys.argv[2]) if len(sys.argv) > 2 else 1):
    params = gtsam.LevenbergMarquardtParams()
    params.setRelativeErrorTol(1e-7)
    params.setMaxIterations(200)
    began = time.process_time()
    optimizer = gtsam.LevenbergMarquardtOptimizer(graph, values, params)
    result = optimizer.optimize()
    times.append(time.process_time() - began)
print(
    f"gtsam {gtsam.__version__ if hasattr(gtsam, '__version__') else ''} LM: {values.size()} poses, {graph.size() - 1} edges, "
    f"cost {graph.error(values):.9f} -> {graph.error(result):.9f}, {optimizer.iterations()} iterations, "
    f"cpu {sorted(times)[len(times) // 2]:.3f} s"
)
