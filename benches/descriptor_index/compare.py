# Ours and faiss on the same descriptors, one thread each, taking turns:
#   python compare.py PROGRAM FOLDER
# PROGRAM is target/release/examples/descriptor_index, FOLDER what `PROGRAM FOLDER make 1000000` wrote. Needs faiss-cpu and numpy. A
# line each turn: CPU time per query of all queries, and the share of queries whose source is among the 25 found.
import subprocess
import sys
import time

import faiss
import numpy as np

faiss.omp_set_num_threads(1)
program, folder = sys.argv[1:3]
turns = 3


def bvecs(name):
    return np.memmap(f'{folder}/{name}', np.uint8, 'r').reshape(-1, 132)[:, 4:]


base, queries = bvecs('base.bvecs'), bvecs('queries.bvecs').astype('f4')
exact = np.fromfile(f'{folder}/exact.ivecs', 'u4').reshape(-1, 26)[:, 1:]


def built(spec):
    index = faiss.index_factory(128, spec)
    rng = np.random.default_rng(1)
    index.train(base[np.sort(rng.choice(len(base), min(len(base), 131072), replace=False))].astype('f4'))
    for start in range(0, len(base), 250_000):
        index.add(base[start:start + 250_000].astype('f4'))
    return index


def faiss_turn(index):
    start = time.process_time()
    found = index.search(queries, 25)[1]
    spent = (time.process_time() - start) / len(queries)
    source = np.mean([i in row for i, row in enumerate(found)])
    first = np.mean([e[0] in row for e, row in zip(exact, found)])
    whole = np.mean([len(np.intersect1d(e, row)) / 25 for e, row in zip(exact, found)])
    return f'{spent * 1e3:8.4f} ms, source {source:.4f}, nearest {first:.4f}, recall@25 {whole:.4f}'


def our_turn(row):
    out = subprocess.run([program, folder, 'row', *row.split()], capture_output=True, text=True, check=True)
    return out.stdout.splitlines()[-1]


for spec, probes, rows in [('IVF1024,PQ16', 16, sys.argv[3:] or ['16 8 1024 16 25']), ('PQ16', None, ['16 8 1 1 25'])]:
    index = built(spec)
    if probes:
        index.nprobe = probes
    for _ in range(turns):
        print(f'faiss {spec} {probes or ""}: {faiss_turn(index)}', flush=True)
        for row in rows:
            print(f'ours: {our_turn(row)}', flush=True)
