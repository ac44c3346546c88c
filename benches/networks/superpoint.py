# SuperPoint, one operator of onnxruntime at a time.
import numpy as np

from aliked import conv, op

MAGIC_LEAP = 'conv1a conv1b conv2a conv2b conv3a conv3b conv4a conv4b convPa convPb convDa convDb'.split()
OPEN = ['backbone.%d.%d' % (i, j) for i in range(4) for j in range(2)] + ['detector.0', 'detector.1', 'descriptor.0', 'descriptor.1']
SHAPES = [(64, 1, 3), (64, 64, 3), (64, 64, 3), (64, 64, 3), (128, 64, 3), (128, 128, 3), (128, 128, 3), (128, 128, 3),
          (256, 128, 3), (65, 256, 1), (256, 128, 3), (256, 256, 1)]


def shapes(names):
    for name, (outputs, inputs, side) in zip(names, SHAPES):
        inner = '.conv' if '.' in name else ''
        yield f'{name}{inner}.weight', (outputs, inputs, side, side)
        yield f'{name}{inner}.bias', (outputs,)
        if inner:
            for part in ('weight', 'bias', 'running_mean', 'running_var'):
                yield f'{name}.bn.{part}', (outputs,)


class SuperPoint:
    def __init__(self, weights):
        self.w = weights
        self.names = MAGIC_LEAP if 'conv1a.weight' in weights else OPEN

    def layer(self, x, index):
        w, name = self.w, self.names[index]
        inner = '.conv' if '.' in name else ''
        x = conv(x, w[f'{name}{inner}.weight'], w[f'{name}{inner}.bias'])
        if index not in (9, 11):
            x = op('Relu', x)
        if inner:
            x = op('BatchNormalization', x, *(w[f'{name}.bn.{p}'] for p in ('weight', 'bias', 'running_mean', 'running_var')), epsilon=1e-3)
        return x

    def maps(self, grey):
        h, w = grey.shape
        x = np.pad(grey, ((0, -h % 8), (0, -w % 8)), mode='edge')[None, None]
        for index in range(8):
            if index in (2, 4, 6):
                x = op('MaxPool', x, kernel_shape=(2, 2), strides=(2, 2))
            x = self.layer(x, index)
        scores = op('Softmax', self.layer(self.layer(x, 8), 9), axis=1)[0, :-1]
        _, rows, columns = scores.shape
        scores = scores.reshape(8, 8, rows, columns).transpose(2, 0, 3, 1).reshape(8*rows, 8*columns)[:h, :w]
        desc = self.layer(self.layer(x, 10), 11)[0]
        return scores, desc / np.linalg.norm(desc, axis=0)
