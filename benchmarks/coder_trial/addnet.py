import numpy as np, torch, sys
torch.manual_seed(0); torch.set_num_threads(1)
H,HO=int(sys.argv[1]),int(sys.argv[2]); files=sys.argv[3].split(','); test=sys.argv[4]; out=sys.argv[5]
rng=np.random.default_rng(0)
def ld(p): return np.fromfile(p,np.float32).reshape(-1,22)
def cut(a):
    keep=(a[:,19]>0)|(rng.random(len(a))<.5); w=np.where(a[:,19]>0,1,2).astype(np.float32)   # thin the empty ones
    return a[keep],w[keep]
def feats(a):
    k=torch.from_numpy(np.clip(a[:,0].astype(int)+4,0,13)); e=torch.from_numpy(a[:,1:10].copy()); d=np.maximum(a[:,17:18],1e-4)
    o=torch.from_numpy(np.concatenate([np.log2(a[:,12:17]/d+.3),np.log2(a[:,17:18]+1e-4)],1)); return k,e,o
A=[cut(ld(f)) for f in files]; w=torch.from_numpy(np.concatenate([b for _,b in A])); a=np.concatenate([x for x,_ in A]); del A
k,e,o=feats(a); Y=torch.from_numpy(a[:,19].copy()); D=torch.from_numpy(a[:,20].copy())
me,se,mo,so=e.mean(0),e.std(0),o.mean(0),o.std(0)+1e-3
b1=torch.nn.Embedding(14,H); W1=torch.nn.Linear(9,H,bias=False); w2=torch.nn.Linear(H,1,bias=False); bk=torch.nn.Embedding(14,1)
ob=torch.nn.Embedding(14,HO); oW=torch.nn.Linear(6,HO,bias=False); ow=torch.nn.Linear(HO,1,bias=False)
with torch.no_grad():
    for m in (b1,ob): m.weight.mul_(.3)
    bk.weight.zero_()
mods=[b1,W1,w2,bk,ob,oW,ow]; ps=[p for m in mods for p in m.parameters()]
def f(k,e,o): return (bk(k)+w2(torch.relu(b1(k)+W1((e-me)/se)))+ow(torch.relu(ob(k)+oW((o-mo)/so))))[:,0].clamp(-8,6)
B=4096;ep=6;n=len(Y);steps=ep*n//B;opt=torch.optim.Adam(ps,2e-3);sch=torch.optim.lr_scheduler.OneCycleLR(opt,8e-3,total_steps=steps+1)
for s in range(steps):
    i=torch.randint(0,n,(B,)); l=f(k[i],e[i],o[i]); loss=(w[i]*(D[i]*l.exp()-Y[i]*l)).sum()/B*20
    opt.zero_grad(); loss.backward(); opt.step(); sch.step()
with torch.no_grad():
    for t in test.split(','):
        te=ld(t); l=f(*feats(te)).exp().double().numpy(); key=te[:,21].astype(int)*64+te[:,0].astype(int)+8; Z=np.bincount(key,weights=l); C=np.bincount(key); cnt=te[:,19]
        dens=te[:,20]; idl=((cnt*np.log2(l)).sum()-((l-1)*dens).sum()/np.log(2))/cnt.sum()
        print(H,HO,n,t,'normalised %.3f sequential %.3f'%((cnt*np.log2(l/(Z[key]/C[key]))).sum()/cnt.sum(),idl),flush=True)
    We=W1.weight/se; Be=b1.weight-(W1.weight*(me/se)).sum(1); Wo=oW.weight/so; Bo=ob.weight-(oW.weight*(mo/so)).sum(1)
    with open(out,'wb') as g:
        np.array([H,HO,0,0],np.int32).tofile(g)
        for t in (Be,We,w2.weight,bk.weight,Bo,Wo,ow.weight): t.numpy().astype(np.float32).tofile(g)
