"""Expected values of the camera models, rotations and splines, from OpenCV, COLMAP, GTSAM and SciPy.

Recipe: python3 -m venv v && v/bin/pip install numpy scipy opencv-contrib-python-headless gtsam pycolmap
        v/bin/python expected.py > expected.txt
One line per value: kind, source, inputs | outputs.
"""
import cv2, gtsam, numpy as np, pycolmap
from scipy.interpolate import BSpline
from scipy.spatial.transform import Rotation

rng = np.random.default_rng(7)
line = lambda kind, source, given, got: print(kind, source, *(repr(float(x)) for x in np.ravel(given)), "|", *(repr(float(x)) for x in np.ravel(got)))
points = np.concatenate([rng.uniform([-.8, -.6, .9], [.8, .6, 1.4], (12, 3)), [[0, 0, 1.0], [1e-7, 0, 2.0], [.3, -.2, .5]]])
K = lambda fx, fy, cx, cy: np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
zero = np.zeros(3)

# pixel, then d pixel / d point (2×3, by rows), then d pixel / d (f, c, distortion) by rows, where the source has them
radtan = [500, 510, 320, 240, -.28, .07, 1e-3, -5e-4, -.006]
fisheye = [350, 352, 321, 198.5, .01, -.02, .005, -.001]
for p in points:
    q, J = cv2.projectPoints(p.reshape(1, 1, 3), zero, zero, K(*radtan[:4]), np.array(radtan[4:]))
    # OpenCV: rotation, translation (= point), f, c, k1 k2 p1 p2 k3
    line("pinhole-radtan", "opencv", [*radtan, *p], [*q.ravel(), *J[:, 3:6].ravel(), *J[:, 6:15].ravel()])
    q, J = cv2.fisheye.projectPoints(p.reshape(1, 1, 3), zero, zero, K(*fisheye[:4]), np.array(fisheye[4:]))
    # OpenCV fisheye: f, c, k1..k4, rotation, translation
    if np.hypot(*p[:2]) > 1e-5:
        line("kannala-brandt", "opencv", [*fisheye, *p], [*q.ravel(), *J[:, 11:14].ravel(), *J[:, 0:8].ravel()])
    for xi in (.4, 1.3):
        # Mei's unified model is the double sphere with xi = 0 and the extended unified model with beta = 1
        q, _ = cv2.omnidir.projectPoints(p.reshape(1, 1, 3), zero, zero, K(300, 301, 321, 198.5), xi, np.zeros(4))
        alpha = xi / (1 + xi)
        f = np.array([300, 301]) / (1 + xi)
        line("double-sphere", "opencv-omnidir", [*f, 321, 198.5, 0, alpha, *p], q)
        line("extended-unified", "opencv-omnidir", [*f, 321, 198.5, alpha, 1, *p], q)

def colmap(model, params, p):
    camera = pycolmap.Camera.create_from_model_name(camera_id=1, model_name=model, focal_length=1, width=640, height=480)
    camera.params = params
    # COLMAP puts (0.5, 0.5) at the centre of the first pixel: principal points are passed as they are
    return camera.img_from_cam(np.asarray(p).reshape(1, 3))

for p in points:
    line("pinhole-radtan", "colmap", [500, 510, 320, 240, -.28, .07, 1e-3, -5e-4, 0, *p], colmap("OPENCV", [500, 510, 320, 240, -.28, .07, 1e-3, -5e-4], p))
    line("kannala-brandt", "colmap", [*fisheye, *p], colmap("OPENCV_FISHEYE", fisheye, p))
    line("field-of-view", "colmap", [256, 257, 321, 198.5, .92, *p], colmap("FOV", [256, 257, 321, 198.5, .92], p))
    for name in ("EUCM",):
        try:
            line("extended-unified", "colmap", [300, 301, 321, 198.5, .62, 1.1, *p], colmap(name, [300, 301, 321, 198.5, .62, 1.1], p))
        except Exception:
            pass

for p in points[:8]:
    n = p[:2] / p[2]
    calibration = gtsam.Cal3Fisheye(350, 352, 0, 321, 198.5, *fisheye[4:])
    line("kannala-brandt", "gtsam", [*fisheye, *p], calibration.uncalibrate(n))

for scale in (1e-9, 1e-5, 1e-3, .1, 1, 1.7, np.pi / np.sqrt(.77) - 1e-7):
    phi = np.array([.4, -.6, .5]) * scale
    line("so3-exp", "scipy", phi, Rotation.from_rotvec(phi).as_quat())
    line("so3-exp", "gtsam", phi, (lambda q: [q.x(), q.y(), q.z(), q.w()])(gtsam.Rot3.Expmap(phi).toQuaternion()))
    xi = np.concatenate([phi, [1.0, -2.0, .7]])
    line("se3-exp", "gtsam", xi, gtsam.Pose3.Expmap(xi).matrix()[:3])
    line("se3-right-jacobian", "gtsam", xi, gtsam.Pose3.ExpmapDerivative(xi))

# splines: R³ against scipy's B-splines, SO(3) by the cumulative product in scipy's rotations
for order in (4, 5, 6):
    spacing, control = .25, rng.uniform(-1, 1, (order, 3))
    knots = (np.arange(2 * order) - (order - 1)) * spacing
    for fraction in (0, .3, .99):
        t = fraction * spacing
        curve = BSpline(knots, control, order - 1)
        line("spline-position", f"scipy{order}", [spacing, fraction, *control.ravel()], [curve(t), curve(t, 1), curve(t, 2)])
        weights = [BSpline.basis_element(knots[j:j + order + 1], extrapolate=False)(t) for j in range(order)]
        cumulative = np.cumsum(np.nan_to_num(weights)[::-1])[::-1]
        r = [Rotation.from_rotvec(c) for c in control]
        total = r[0]
        for j in range(1, order):
            total = total * Rotation.from_rotvec((r[j - 1].inv() * r[j]).as_rotvec() * cumulative[j])
        line("spline-rotation", f"scipy{order}", [spacing, fraction, *control.ravel()], total.as_quat())
