# The numbers that `lsfb models check` compares with: python reference.py FOLDER, with xfeat.onnx and alike-t.onnx in it, exported from the
# authors' weights (dense maps, before any keypoint is chosen). Needs onnxruntime and numpy.
import sys

import numpy as np
import onnxruntime as ort

def img(w,h):
    y,x=np.mgrid[0:h,0:w].astype(np.int64)
    v=(x*x//7+3*x*y//11+y*y//5+90*((x//16+y//16)%2))%256
    return v
out=''
for name,f in (('XFEAT','xfeat'),('ALIKE_T','alike-t')):
    s=ort.InferenceSession(f'{sys.argv[1]}/{f}.onnx')
    out+=f'const {name}: [[[f32; 2]; PROBES]; 2] = [\n'
    for w,h in ((320,256),(192,224)):
        a=(img(w,h)/255).astype(np.float32)[None,None]
        if name!='XFEAT': a=np.repeat(a,3,1)
        r=dict(zip([o.name for o in s.get_outputs()],s.run(None,{'image':a})))
        rows=[]
        for i in range(12):
            c,y=(37*i+11)%w,(53*i+7)%h; ch=(7*i)%64
            if name=='XFEAT': v=[(r['scores'][0,0,:,c]*np.repeat(r['reliability'][0,0,:,c//8],8)).max(),r['desc'][0,ch,y//8,c//8]]
            else: v=[r['scores'][0,0,:,c].max(),r['desc'][0,ch,y,c]]
            rows.append('[%s, %s]'%tuple(repr(float('%.6g'%q)) for q in v))
        out+='    ['+', '.join(rows)+'],\n'
    out+='];\n'
print(out)
