# The networks of the family ALIKED, one operator of onnxruntime at a time.
import functools

import numpy as np
import onnx
import onnxruntime as ort
from onnx import helper as H

@functools.lru_cache(None)
def session(kind, inputs, attributes):
    names = [f'i{k}' for k in range(inputs)]
    value = lambda n: H.make_tensor_value_info(n, onnx.TensorProto.FLOAT, None)
    node = H.make_node(kind, names, ['o'], **dict(attributes))
    graph = H.make_graph([node], 'g', [value(n) for n in names], [value('o')])
    model = H.make_model(graph, opset_imports=[H.make_opsetid('', 20)], ir_version=9)
    return ort.InferenceSession(model.SerializeToString())

def op(kind, *inputs, **attributes):
    s = session(kind, len(inputs), tuple(sorted(attributes.items())))
    return s.run(None, {f'i{k}': np.ascontiguousarray(v, np.float32) for k, v in enumerate(inputs)})[0]

def conv(x, w, b=None, pad=None):
    pad = w.shape[2] // 2 if pad is None else pad
    return op('Conv', x, w, *([] if b is None else [b]), pads=(pad,) * 4)

class Aliked:
    def __init__(self, weights):
        self.w = weights

    def bn(self, x, n):
        w = self.w
        return op('BatchNormalization', x, w[n+'.weight'], w[n+'.bias'], w[n+'.running_mean'], w[n+'.running_var'], epsilon=1e-5)
    def conv3(self, x, n):
        w = self.w
        if n + '.weight' in w: return conv(x, w[n+'.weight'])
        largest = max(x.shape[2:]) / 4
        offsets = np.clip(conv(x, w[n+'.offset_conv.weight'], w[n+'.offset_conv.bias']), -largest, largest)
        return op('DeformConv', x, w[n+'.regular_conv.weight'], offsets, kernel_shape=(3, 3), pads=(1, 1, 1, 1))
    def block(self, x, n):
        y = op('Selu', self.bn(self.conv3(x, n+'.conv1'), n+'.bn1'))
        y = self.bn(self.conv3(y, n+'.conv2'), n+'.bn2')
        if n+'.downsample.weight' in self.w:
            y = y + conv(x, self.w[n+'.downsample.weight'], self.w[n+'.downsample.bias'])
        return op('Selu', y)
    def maps(self, grey):
        h, w = grey.shape
        ph, pw = -h % 32, -w % 32
        rim = ((ph//2, ph-ph//2), (pw//2, pw-pw//2))
        x = np.pad(grey, rim, mode='edge')[None, None].repeat(3, 1)
        H_, W_ = x.shape[2:]
        maps = []
        for i, pool in enumerate((1, 2, 4, 4), 1):
            if pool > 1: x = op('AveragePool', x, kernel_shape=(pool, pool), strides=(pool, pool))
            x = self.block(x, f'block{i}')
            m = op('Selu', conv(x, self.w[f'conv{i}.weight']))
            maps.append(self.enlarged(m, H_, W_))
        feature = np.concatenate(maps, 1)
        s = feature
        for i in (0, 2, 4, 6):
            s = conv(s, self.w[f'score_head.{i}.weight'])
            s = op('Selu', s) if i < 6 else 1 / (1 + np.exp(-s))
        feature = feature / np.maximum(np.linalg.norm(feature, axis=1, keepdims=True), 1e-12)
        cut = lambda m: m[:, :, rim[0][0]:H_-rim[0][1], rim[1][0]:W_-rim[1][1]]
        return cut(s), cut(feature)
    @staticmethod
    def enlarged(m, H_, W_):
        y, x = np.meshgrid(np.linspace(-1, 1, H_), np.linspace(-1, 1, W_), indexing='ij')
        return op('GridSample', m, np.stack((x, y), -1)[None], align_corners=1, mode='linear', padding_mode='border')
    def describe(self, feature, points):
        w, out = self.w, []
        c, fh, fw = feature.shape[1:]
        size = np.array([fw - 1, fh - 1])
        for p in np.atleast_2d(points):
            corner = np.trunc(np.trunc(p) - 1.5 + 1).astype(int)
            corner = [min(max(corner[0], 0), fw - 4), min(max(corner[1], 0), fh - 4)]
            patch = feature[:, :, corner[1]:corner[1]+3, corner[0]:corner[0]+3]
            o = op('Selu', conv(patch, w['desc_head.offset_conv.0.weight'], w['desc_head.offset_conv.0.bias'], 0))
            o = conv(o, w['desc_head.offset_conv.2.weight'], w['desc_head.offset_conv.2.bias'])
            o = np.clip(o, -max(fh, fw)/4, max(fh, fw)/4).reshape(2, -1).T
            grid = 2 * (p + o) / size - 1
            f = op('GridSample', feature, grid[None, :, None], align_corners=1, mode='linear', padding_mode='zeros')
            f = op('Selu', conv(f, w['desc_head.sf_conv.weight']))[0, :, :, 0]
            d = np.einsum('cp,pcd->d', f.astype(np.float64), w['desc_head.agg_weights'])
            out.append(d / max(np.linalg.norm(d), 1e-12))
        return np.array(out)
