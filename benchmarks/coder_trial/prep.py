from pathlib import Path
from PIL import Image
import sys
sys.path.insert(0,'CHECKOUT')
from benchmarks.perceptual.photographs import PICTURES, name_of
out=Path('train'); out.mkdir(exist_ok=True)
names=PICTURES['tuning'].split()
found={}
for p in Path('debs/x').rglob('*.jpg'):
    if p.parent.name!='images' or p.stem=='2560x1600': found[name_of(p)]=p
for n in names:
    im=Image.open(found[n]).convert('RGB')
    s=768/max(im.size); im.resize((round(im.width*s),round(im.height*s)),Image.Resampling.LANCZOS).save(out/f'{n}.png')
    # half of the source, two crops
    f=min(1,max(1536/max(im.size),.5)); h=im.resize((round(im.width*f),round(im.height*f)),Image.Resampling.LANCZOS)
    w,hh=h.size; cw,ch=min(768,w),min(512,hh)
    h.crop((w//8,hh//2-ch//2,w//8+cw,hh//2-ch//2+ch)).save(out/f'{n}-l.png')
    h.crop((w-w//8-cw,hh-ch,w-w//8,hh)).save(out/f'{n}-r.png')
for n in 'astronaut coffee chelsea motorcycle_left'.split():
    Image.open(f'CHECKOUT/.venv/lib/python3.11/site-packages/skimage/data/{n}.png').convert('RGB').save(out/f'sk-{n}.png')
for n in 'rocket retina hubble_deep_field'.split():
    im=Image.open(f'CHECKOUT/.venv/lib/python3.11/site-packages/skimage/data/{n}.jpg').convert('RGB'); im.thumbnail((768,768),Image.Resampling.LANCZOS); im.save(out/f'sk-{n}.png')
