import subprocess,sys,re
TR="dump/train/0.1,dump/train/0.25,dump/train/0.4"; TE=[f"dump/{d}/{r}" for d in("kodak","other") for r in("0.1","0.25","0.4")]
def run(o,prog="./cl3"):
    t=subprocess.run([prog,TR,*TE,*o.split()],capture_output=True,text=True).stdout
    out=[]
    for m in re.finditer(r"gauss (\d+) payload ([\d.]+) modelled ([\d.]+) file ([\d.]+) \| place ([\d.]+)",t): out.append([float(x) for x in m.groups()])
    return out
L="leaf=1 minblk=3 minb=2 net=1 T=6 minl=12 maxl=12"
for name,o in [("today's models, trained starts",""),("places by net",L),("own numbers, linear","own=1 mix=3"),("directions, linear","dirs=1 mix=3"),("places, directions, linear",L+" dirs=1 mix=3"),("all, linear",L+" own=1 dirs=1 mix=3"),("all, logistic",L+" own=1 dirs=1 mix=2")]:
    r=run(o); print(f"{name:34s}"," ".join(f"{100*(x[2]-x[1])/x[3]:+.2f}" for x in r),flush=True)
