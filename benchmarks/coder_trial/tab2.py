exec(open('tab.py').read().split("L=\"leaf")[0])
L="leaf=1 minblk=3 minb=2 net=1 T=6 minl=12 maxl=12"
for name,o in [("all, few tables, linear",L+" own=2 dirs=1 mix=3 mind=3"),("all, few tables, logistic",L+" own=2 dirs=1 mix=2 mind=3")]:
    r=run(o,"./cl4"); print(f"{name:34s}"," ".join(f"{100*(x[2]-x[1])/x[3]:+.2f}" for x in r),flush=True)
