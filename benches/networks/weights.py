# Weights of PyTorch files, without PyTorch, and weights made by a formula.
import pickle
import zipfile

import numpy as np


class Dictionary(dict):
    pass


class List(pickle.Unpickler):
    def __init__(self, archive, name):
        super().__init__(archive.open(name))
        self.archive, self.folder = archive, name.removesuffix('data.pkl')

    def find_class(self, module, name):
        if name == '_rebuild_tensor_v2':
            return lambda values, offset, shape, *_: values[offset:offset + int(np.prod(shape))].reshape(shape)
        return Dictionary if name == 'OrderedDict' else lambda *a, **k: None

    def persistent_load(self, storage):
        return np.frombuffer(self.archive.read(f'{self.folder}data/{storage[2]}'), np.float32)


def read(file):
    archive = zipfile.ZipFile(file)
    name = next(n for n in archive.namelist() if n.endswith('data.pkl'))
    tensors = List(archive, name).load()
    return {k: v for k, v in tensors.items() if not k.endswith('num_batches_tracked')}


def generated(shapes):
    # As crates/networks/src/generated.rs.
    tensors = {}
    for name, shape in shapes.items():
        state, count = 1, int(np.prod(shape))
        for byte in name.encode():
            state = (state*31 + byte) & 0xffffffff
        spread = np.sqrt(np.float32(3)/np.float32(max(count//shape[0], 1)))
        usual = (1, 0.2) if len(shape) == 1 else (0, spread)
        middle, spread = {'running_var': (1, 0.5), 'running_mean': (0, 0.1), 'bias': (0, 0.1)}.get(name.rsplit('.')[-1], usual)
        values = np.empty(count, np.float32)
        for i in range(count):
            state = (state*1664525 + 1013904223) & 0xffffffff
            values[i] = np.float32(state >> 8)/np.float32(8388608) - np.float32(1)
        tensors[name] = (np.float32(middle) + np.float32(spread)*values).reshape(shape)
    return tensors
