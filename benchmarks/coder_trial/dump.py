import sys, os, time
from pathlib import Path
import numpy as np
sys.path.insert(0,'CHECKOUT/tests/bitstream')
import plain_decoder_v2 as D
idle=0
while idle<40:
    did=0
    for p in sorted(Path('sg').rglob('*.sg')):
        q=Path('dump')/p.relative_to('sg').with_suffix('.bin')
        if q.exists() or time.time()-p.stat().st_mtime<1: continue
        f=D.read(p.read_bytes()); h=f.header
        rows=[]
        for g in f.integers():
            c,r=D.deinterleave(g.cell)
            rows.append([g.of_class.k,c,r,*g.colour,*g.shape,*g.place,*g.parts,g.u_bits])
        a=np.array(rows,np.int32)
        q.parent.mkdir(parents=True,exist_ok=True)
        head=np.array([h.width,h.height,len(f.payload),p.stat().st_size,h.grey,h.upright,int(h.quantum*2**20),len(a)],np.int32)
        q.with_suffix('.tmp').write_bytes(head.tobytes()+a.tobytes()); q.with_suffix('.tmp').rename(q); did+=1
    idle=0 if did else idle+1
    time.sleep(5)
