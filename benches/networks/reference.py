# The numbers that `lsfb models check` and the tests of crates/networks compare with: python reference.py EXPORTED PUBLISHED, the folders of
# xfeat.onnx and alike-t.onnx, exported from the authors' weights (dense maps, before any keypoint is chosen), and of the authors' own
# aliked-t16.pth and aliked-n16rot.pth. Needs onnx, onnxruntime and numpy.
import sys

import numpy as np
import onnxruntime as ort

from aliked import Aliked
from superpoint import MAGIC_LEAP, OPEN, SuperPoint, shapes
from weights import generated, read


def pattern(w, h):
    y, x = np.mgrid[0:h, 0:w].astype(np.int64)
    v = (x*x//7 + 3*x*y//11 + y*y//5 + 90*((x//16 + y//16) % 2)) % 256
    return (v/255).astype(np.float32)


def table(name, sizes, probe):
    print(f'const {name}: Expected = [')
    for w, h in sizes:
        rows = [', '.join(repr(float('%.6g' % v)) for v in row) for row in probe(w, h)]
        print(f'    ([{w}, {h}], [[' + '], ['.join(rows) + ']]),')
    print('];')


def exported(file):
    session = ort.InferenceSession(file)
    colours = session.get_inputs()[0].shape[1]

    def probe(w, h):
        image = np.repeat(pattern(w, h)[None, None], colours, 1)
        maps = dict(zip([o.name for o in session.get_outputs()], session.run(None, {'image': image})))
        for i in range(12):
            c, y, channel = (37*i + 11) % w, (53*i + 7) % h, 7*i % 64
            scores, desc = maps['scores'][0, 0, :, c], maps['desc'][0, channel]
            if 'reliability' in maps:
                yield (scores*np.repeat(maps['reliability'][0, 0, :, c//8], 8)).max(), desc[y//8, c//8]
            else:
                yield scores.max(), desc[y, c]
    return probe


def aliked(weights, places, step):
    network = Aliked(weights)

    def probe(w, h):
        scores, features = network.maps(pattern(w, h))
        for i in range(places):
            c, y = (37*i + 11) % w, (step*i + 7) % h
            yield scores[0, 0, :, c].max(), network.describe(features, np.array([[c, y]]))[0][7*i % 64]
    return probe


def superpoint(names):
    network = SuperPoint(generated(dict(shapes(names))))

    def probe(w, h):
        scores, descriptors = network.maps(pattern(w, h))
        for i in range(4):
            c, y = (37*i + 11) % w, (23*i + 7) % h
            yield scores[:, c].max(), descriptors[41*i % 256, y//8, c//8]
    return probe


exports, published = sys.argv[1:]
table('XFEAT', ((320, 256), (192, 224)), exported(f'{exports}/xfeat.onnx'))
table('ALIKE_T', ((320, 256), (192, 224)), exported(f'{exports}/alike-t.onnx'))
tiny = read(f'{published}/aliked-t16.pth')
table('ALIKED_T16', ((320, 256), (200, 150)), aliked(tiny, 12, 53))
table('ALIKED_N16ROT', ((320, 256), (200, 150)), aliked(read(f'{published}/aliked-n16rot.pth'), 12, 53))
table('ALIKED_GENERATED', ((96, 64), (75, 50)), aliked(generated({k: v.shape for k, v in tiny.items()}), 6, 23))
table('SUPERPOINT_GENERATED', ((64, 48), (75, 50)), superpoint(MAGIC_LEAP))
table('SUPERPOINT_OPEN_GENERATED', ((64, 48), (75, 50)), superpoint(OPEN))
