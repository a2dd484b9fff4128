// Code lengths of the same integers under contexts. g++ -O2 -march=native
#include <cstdio>
#include <cmath>
#include <cstring>
#include <cstdlib>
#include <vector>
#include <string>
#include <array>
#include <map>
#include <algorithm>
#include <fstream>
#include <functional>
using namespace std;
typedef vector<double> V;
struct G{int k,c,r,y,a,b,u,v,rr,X,Y,px,py,ub; double x,yy_,l1,l2,l3,S; int h;};
struct File{string name;int W,H,payload,size,grey,upright,quantum;vector<G> g;};
static File load(const string&p){File f;f.name=p;FILE*s=fopen(p.c_str(),"rb");int h[8];if(fread(h,4,8,s)!=8)exit(1);
 f.W=h[0];f.H=h[1];f.payload=h[2];f.size=h[3];f.grey=h[4];f.upright=h[5];f.quantum=h[6];int n=h[7];vector<int>d(14*(size_t)n);if(n&&fread(d.data(),4,d.size(),s)!=d.size())exit(1);fclose(s);
 for(int i=0;i<n;i++){int*q=&d[14*i];G g;g.k=q[0];g.c=q[1];g.r=q[2];g.y=q[3];g.a=q[4];g.b=q[5];g.u=q[6];g.v=q[7];g.rr=q[8];g.X=q[9];g.Y=q[10];g.px=q[11];g.py=q[12];g.ub=q[13];
  double S=(double)g.y*g.y+(double)g.a*g.a+(double)g.b*g.b;g.S=S;int h=0;while(pow(2.,2*h+1)<=S)h++;g.h=min(h,18);
  double s=pow(2,g.k/2.),U=((g.u+.5)/(1<<g.ub)-.5)*.34657359,Vv=g.v*pow(2.,-g.h),R=g.rr*2*pow(2.,-g.h);g.l1=s*exp(U+Vv);g.l3=s*exp(U-Vv);g.l2=R*g.l3;
  int gb=max(0,(g.k+1)/2); if(g.k<0)gb=0; g.x=(g.c-2+(g.X+.5)/(1<<g.px))*(1<<gb);g.yy_=(g.r-2+(g.Y+.5)/(1<<g.py))*(1<<gb);f.g.push_back(g);}
 return f;}
static int gof(int k){return k<=0?0:(k+1)/2;}
// --- adaptive model, as the coder's
struct Model{int fast[17],slow[17],seen=0;bool init=false;
 void start(const uint8_t*b){for(int i=1;i<16;i++)fast[i]=slow[i]=32704*b[i-1]/256+4*i;fast[0]=slow[0]=0;fast[16]=slow[16]=32768;seen=0;init=true;}
 int edge(int i)const{return i==0?0:i==16?32768:(fast[i]+slow[i])>>1;}
 double p(int s)const{return (edge(s+1)-edge(s))/32768.;}
 void up(int s,int maxj=7,int fs=5){int j=0;while((seen+16)>>(j+1))j++;j=min(j,maxj);seen++;for(int i=1;i<16;i++){int aim=4*i+(i>s?32704:0);fast[i]+=(aim-fast[i]+(1<<fs>>1)-1)>>fs;slow[i]+=(aim-slow[i]+(1<<(j-1))-1)>>j;}}
};
struct Opt{int leaf=0,dirs=0,colour=0,minblk=2,table=0,mix=0,near=0;int T=0,mind=2,db=1,minb=0,net=0;double fq=16;double maxl=4,na=1,ps=8;int minl=4;int pic=0,minpic=1,own=0;} O;
struct Starts{map<string,vector<array<double,16>>> cnt;map<string,vector<array<uint8_t,15>>> tab;
 void count(const string&n,int row,int s){auto&t=cnt[n];if((int)t.size()<=row)t.resize(row+1,{});t[row][s]++;}
 void finish(){for(auto&kv:cnt){vector<array<uint8_t,15>> out;array<double,16> all{};for(auto&r:kv.second)for(int i=0;i<16;i++)all[i]+=r[i];double A=0;for(double x:all)A+=x;
   for(auto&r:kv.second){double N=0;for(double x:r)N+=x;array<uint8_t,15> o;double c=0,tot=N+8;for(int i=0;i<15;i++){c+=r[i]+8*(all[i]+.02)/(A+.32);o[i]=(uint8_t)min(255.,max(0.,floor(256*c/tot+.5)));}out.push_back(o);}
   tab[kv.first]=out;}}};
static Starts ST; static bool TRAIN;
struct Bank{string name;vector<Model> m;explicit Bank(string n):name(n){}
 Model&get(int row){if((int)m.size()<=row)m.resize(row+1);Model&o=m[row];if(!o.init){auto&t=ST.tab[name];if(row<(int)t.size())o.start(t[row].data());else{uint8_t b[15];for(int i=0;i<15;i++)b[i]=16*(i+1);o.start(b);}}return o;}
 double code(int row,int s){if(TRAIN){ST.count(name,row,s);return 0;}Model&o=get(row);double p=o.p(s);o.up(s);return -log2(p);}
};
// mean of two models
static double code2(Bank&A,int ra,Bank&B,int rb,int s,double w=.5){if(TRAIN){ST.count(A.name,ra,s);ST.count(B.name,rb,s);return 0;}Model&x=A.get(ra),&y=B.get(rb);double p=(1-w)*x.p(s)+w*y.p(s);x.up(s);y.up(s);return -log2(p);}
struct MixW{double w[2]={0.3,0.3};};
// logistic-like mix over the whole symbol distribution: p ∝ pa^w1 pb^w2, online gradient
static double codeL(Bank&A,int ra,Bank&B,int rb,MixW&W,int s){if(TRAIN){ST.count(A.name,ra,s);ST.count(B.name,rb,s);return 0;}Model&x=A.get(ra),&y=B.get(rb);double la[16],lb[16],q[16],Z=0;for(int i=0;i<16;i++){la[i]=log(x.p(i));lb[i]=log(y.p(i));q[i]=exp(W.w[0]*la[i]+W.w[1]*lb[i]);Z+=q[i];}
 double ea=0,eb=0;for(int i=0;i<16;i++){q[i]/=Z;ea+=q[i]*la[i];eb+=q[i]*lb[i];}double r=.002;double p=q[s];W.w[0]+=r*(la[s]-ea);W.w[1]+=r*(lb[s]-eb);x.up(s);y.up(s);return -log2(p);}
struct Ref{Bank*b;int row;double w;};
static double EW[16][8],EN[16][8];static bool EM=false;
struct LW{int id=0;double w[8];bool init=false;};
static double codeM(vector<Ref> R,int s,LW*W=nullptr){if(TRAIN){for(auto&q:R)ST.count(q.b->name,q.row,s);return 0;}
 if(W&&O.mix==3){int n=R.size();double p=0,q[8];for(int m=0;m<n;m++){q[m]=EW[W->id][m]*R[m].b->get(R[m].row).p(s);p+=q[m];}for(int m=0;m<n;m++){if(EM)EN[W->id][m]+=q[m]/p;R[m].b->get(R[m].row).up(s);}return -log2(p);}
 if(!W){double p=0,w=0;for(auto&q:R){p+=q.w*q.b->get(q.row).p(s);w+=q.w;}for(auto&q:R)q.b->get(q.row).up(s);return -log2(p/w);}
 int n=R.size();if(!W->init){for(int i=0;i<n;i++)W->w[i]=1.1/n;W->init=true;}
 double l[8][16],q[16],Z=0;for(int i=0;i<16;i++){double x=0;for(int m=0;m<n;m++){l[m][i]=log(R[m].b->get(R[m].row).p(i));x+=W->w[m]*l[m][i];}q[i]=exp(x);Z+=q[i];}
 double p=q[s]/Z;for(int m=0;m<n;m++){double e=0;for(int i=0;i<16;i++)e+=q[i]/Z*l[m][i];W->w[m]+=.002*(l[m][s]-e);R[m].b->get(R[m].row).up(s);}return -log2(p);}
static int symof(unsigned v){if(v<4)return v;if(v>=192)return 15;int top=31-__builtin_clz(v);return 2*top|((v>>(top-1))&1);}
static int restof(int s,unsigned v){if(s<4)return 0;if(s==15){return 5+(31-__builtin_clz(v));}return s/2-1;}
static uint64_t morton(unsigned c,unsigned r){uint64_t o=0;for(int i=0;i<20;i++)o|=(uint64_t)(c>>i&1)<<(2*i)|(uint64_t)(r>>i&1)<<(2*i+1);return o;}
// --- maps of the larger Gaussians
struct Map{int lev=-1,w=0,h=0;vector<float> e,cx,cy,n; // block of 2^lev px, 2 blocks of rim
 void init(int L,int W,int H){lev=L;w=(W>>L)+6;h=(H>>L)+6;e.assign(w*h,0);cx=cy=n=e;}
 static vector<float> enlarge(const vector<float>&a,int w,int h,int nw,int nh){vector<float> o(nw*nh),t(nw*h);for(int y=0;y<h;y++)for(int x=0;x<nw;x++){ // block x of new: px (x-2)*s ; old index 2+(x-2)/2
   int X=x-2;int f=X>=0?X/2:(X-1)/2;int nb=(X&1)?f+1:f-1;f=min(max(f+2,0),w-1);nb=min(max(nb+2,0),w-1);t[y*nw+x]=.75f*a[y*w+f]+.25f*a[y*w+nb];}
  for(int y=0;y<nh;y++){int X=y-2;int f=X>=0?X/2:(X-1)/2;int nb=(X&1)?f+1:f-1;f=min(max(f+2,0),h-1);nb=min(max(nb+2,0),h-1);for(int x=0;x<nw;x++)o[y*nw+x]=.75f*t[f*nw+x]+.25f*t[nb*nw+x];}return o;}
 void down(int L,int W,int H){while(lev>L){int nl=lev-1,nw=(W>>nl)+6,nh=(H>>nl)+6;e=enlarge(e,w,h,nw,nh);cx=enlarge(cx,w,h,nw,nh);cy=enlarge(cy,w,h,nw,nh);n=enlarge(n,w,h,nw,nh);for(auto&q:n)q*=.25f;lev=nl;w=nw;h=nh;}}
 void splat(double x,double y,double E,double CX,double CY,double N){double s=1<<lev;double fx=x/s-.5+2,fy=y/s-.5+2;int ix=floor(fx),iy=floor(fy);double ax=fx-ix,ay=fy-iy;for(int j=0;j<2;j++)for(int i=0;i<2;i++){int xx=ix+i,yy=iy+j;if(xx<0||yy<0||xx>=w||yy>=h)continue;double q=(i?ax:1-ax)*(j?ay:1-ay);e[yy*w+xx]+=q*E;cx[yy*w+xx]+=q*CX;cy[yy*w+xx]+=q*CY;n[yy*w+xx]+=q*N;}}
 void add(const G&g){double xx=g.l1*g.l1,xy=g.l1*g.l2,yy=g.l2*g.l2+g.l3*g.l3,gap=hypot(xx-yy,2*xy),maj=(xx+yy+gap)/2,mnr=max((xx+yy-gap)/2,.05);
  double s2=pow(2.,g.k);double E=g.S/s2/mnr; // energy of the gradient, in units of the quantum
  double lean=gap/(xx+yy),th2=atan2(2*xy,xx-yy);double c=cos(th2),sn=sin(th2);double ux=cos(th2/2),uy=sin(th2/2);double M=sqrt(maj),m=sqrt(mnr);double blk=1<<lev;
  // points along the long axis and across
  int na=min(12,max(1,(int)ceil(2.4*M/max(blk,1.)))),nc=min(6,max(1,(int)ceil(2.0*m/max(blk,1.))));
  double tot=0;vector<array<double,3>> pts;for(int i=0;i<na;i++)for(int j=0;j<nc;j++){double t=na==1?0:(2.*(i+.5)/na-1)*1.5,q=nc==1?0:(2.*(j+.5)/nc-1)*1.3;double wgt=exp(-.5*(t*t+q*q));pts.push_back({g.x+t*M*ux-q*m*uy,g.yy_+t*M*uy+q*m*ux,wgt});tot+=wgt;}
  // total = E * area / block area
  double total=E*M*m*2/(blk*blk);for(auto&p:pts)splat(p[0],p[1],total*p[2]/tot,total*lean*c*p[2]/tot,total*lean*sn*p[2]/tot,p[2]/tot);}
};
static vector<float> box(const vector<float>&a,int w,int h,int r){vector<float> t(a.size()),o(a.size());for(int y=0;y<h;y++){for(int x=0;x<w;x++){float s=0;int n=0;for(int i=-r;i<=r;i++){int q=x+i;if(q>=0&&q<w){s+=a[y*w+q];n++;}}t[y*w+x]=s/n;}}
 for(int y=0;y<h;y++)for(int x=0;x<w;x++){float s=0;int n=0;for(int i=-r;i<=r;i++){int q=y+i;if(q>=0&&q<h){s+=t[q*w+x];n++;}}o[y*w+x]=s/n;}return o;}
struct Pic{int lev=-1,w=0,h=0;vector<float> p,q; void init(int L,int W,int H){lev=L;w=(W>>L)+6;h=(H>>L)+6;p.assign(w*h,0);q=p;}
 void down(int L,int W,int H){while(lev>L){int nl=lev-1,nw=(W>>nl)+6,nh=(H>>nl)+6;p=Map::enlarge(p,w,h,nw,nh);q=Map::enlarge(q,w,h,nw,nh);lev=nl;w=nw;h=nh;}}
 void add(const G&g){double s=1<<lev;double b2=.25;double l1=g.l1/s,l2=g.l2/s,l3=g.l3/s;double xx=l1*l1+b2,xy=l1*l2,yy=l2*l2+l3*l3+b2;double det=xx*yy-xy*xy;double gain=l1*l3/sqrt(det);double st=1./(1.5*pow(2.,g.k/2.));double A=g.y*st*gain,Cc=g.a*st*gain;
  double cx=g.x/s-.5+2,cy=g.yy_/s-.5+2;double rx=2.45*sqrt(xx),ry=2.45*sqrt(yy);int x0=max(0,(int)ceil(cx-rx)),x1=min(w-1,(int)floor(cx+rx)),y0=max(0,(int)ceil(cy-ry)),y1=min(h-1,(int)floor(cy+ry));ops+=max(0,x1-x0+1)*(double)max(0,y1-y0+1);
  for(int y=y0;y<=y1;y++)for(int x=x0;x<=x1;x++){double dx=x-cx,dy=y-cy;double e=.5*(yy*dx*dx-2*xy*dx*dy+xx*dy*dy)/det;if(e>3)continue;double z=exp(-e)-.0498;p[y*w+x]+=A*z;q[y*w+x]+=Cc*z;}}
 static double ops;
 void tensor(vector<float>&e,vector<float>&cx,vector<float>&cy)const{e.assign(w*h,0);cx=cy=e;for(int y=1;y<h-1;y++)for(int x=1;x<w-1;x++){float gx=.5f*(p[y*w+x+1]-p[y*w+x-1]),gy=.5f*(p[(y+1)*w+x]-p[(y-1)*w+x]);
   float hx=.5f*(q[y*w+x+1]-q[y*w+x-1]),hy=.5f*(q[(y+1)*w+x]-q[(y-1)*w+x]);
   e[y*w+x]=gx*gx+gy*gy+hx*hx+hy*hy;cx[y*w+x]=gy*gy-gx*gx+hy*hy-hx*hx;cy[y*w+x]=-2*gx*gy-2*hx*hy;}}
};
double Pic::ops=0;
struct Net{int H=0;vector<float> b1,W1,w2,bk;vector<float> to;/*table o: class group x dens? */ int HO=0;vector<float> ob,oW,ow;float ob2;bool ok=false;
 void load(const char*p){FILE*f=fopen(p,"rb");if(!f)return;int h[4];if(fread(h,4,4,f)!=4)exit(2);H=h[0];HO=h[1];auto rd=[&](vector<float>&v,int n){v.resize(n);if((int)fread(v.data(),4,n,f)!=n)exit(3);};rd(b1,14*H);rd(W1,9*H);rd(w2,H);rd(bk,14);rd(ob,14*HO);rd(oW,6*HO);rd(ow,HO);fclose(f);ok=true;}
 float e(int k,const float*x){float o=bk[k];for(int h=0;h<H;h++){float a=b1[k*H+h];for(int i=0;i<9;i++)a+=W1[h*9+i]*x[i];if(a>0)o+=w2[h]*a;}return o;}
 float o(int k,const float*x){float o=0;for(int h=0;h<HO;h++){float a=ob[k*HO+h];for(int i=0;i<6;i++)a+=oW[h*6+i]*x[i];if(a>0)o+=ow[h]*a;}return o;}
};static Net NET;
static bool PASS2=false;static const int NR=7,NR2=10,NN=70;static double idl=0,idc=0;
static FILE*DUMP=nullptr;static int FI=0;
static double wst=0,qid=0,qn=0;static double ideal=0,unif=0;
struct Bits{double dist=0,raw=0,pos=0,csign=0,ssign=0,v=0,r=0,luma=0,a=0,b=0,u=0,cnt=0;double sum()const{return dist+raw+pos+csign+ssign+v+r+luma+a+b+u+cnt;}};
static vector<array<double,2>> DT[60]; // density table by class group and ctx: count, expected
static int kgrp(int k){return min(k+4,11);}
static int dirctx(double cx,double cy,double e){double coh=hypot(cx,cy)/(e+1e-12);int cb=coh<.2?0:coh<.45?1:coh<.7?2:3;int a=(int)floor((atan2(cy,cx)+M_PI+M_PI/8)/(M_PI/4))%8;return cb==0?0:1+(cb-1)*8+a;}
static Bits run(File&f){
 Bits B;Bank dist("distance"),luma("luma"),a("a"),bb("b"),cs("csign"),v("v"),r("r"),ss("ssign"),cnt("count"),ssd("ssign.d"),vd("v.d"),rd("r.d"),csd("csign.d"),lumad("luma.d"),bl1("l1"),ba1("a1"),bb1("b1"),bb2("b2"),bc1("c1"),bv1("v1"),br1("r1"),br2("r2"),rd2("r.d2"),ss2("ss2"),ss3("ss3"),bd1("d1");LW W_[12];MixW mv,mr,ms,ml;
 Map M,MD;Pic P;size_t i=0;int n=f.g.size();B.cnt=12;
 int kmax=n?f.g[0].k:0;
 double Eall=0;
 for(int k=kmax;k>=(n?f.g[n-1].k:0);k--){size_t j=i;while(j<f.g.size()&&f.g[j].k==k)j++;int c=j-i;B.cnt+=cnt.code(0,symof(c))+restof(symof(c),c);if(!c)continue;
  int g=gof(k);int cols=min((f.W>>g)+5,65536),rows=min((f.H>>g)+5,65536);
  // maps up to date for this class
  int blkexp=max(g+O.minb,O.minblk);bool has=i>=30;
  if(O.pic){int pl=max(g,O.minpic);if(P.lev<0)P.init(max(pl,7),f.W,f.H);if(P.lev>pl)P.down(pl,f.W,f.H);
   // energy of the picture on blocks of the map
   M.lev=blkexp;M.w=(f.W>>blkexp)+6;M.h=(f.H>>blkexp)+6;M.e.assign(M.w*M.h,0);M.cx=M.cy=M.n=M.e;if(has){vector<float> e,cx,cy;P.tensor(e,cx,cy);int d=blkexp-pl;float sc=1.f;for(int y=0;y<P.h;y++)for(int x=0;x<P.w;x++){int X=((x-2)>>d)+2,Y=((y-2)>>d)+2;X=min(max(X,0),M.w-1);Y=min(max(Y,0),M.h-1);M.e[Y*M.w+X]+=sc*e[y*P.w+x];M.cx[Y*M.w+X]+=sc*cx[y*P.w+x];M.cy[Y*M.w+X]+=sc*cy[y*P.w+x];}}
  }
  if(MD.lev<0)MD.init(7,f.W,f.H);{int dl=max(g,O.mind);if(MD.lev>dl)MD.down(dl,f.W,f.H);}
  if(M.lev<0)M.init(max(blkexp,7),f.W,f.H);
  if(M.lev>blkexp)M.down(blkexp,f.W,f.H);
  vector<float> sm,E2,E3,N1;double mean=0;
  if(has&&(O.leaf)){sm=box(M.e,M.w,M.h,1);E2=box(M.e,M.w,M.h,4);double q=0;int nn=0;for(int y=2;y<M.h-4;y++)for(int x=2;x<M.w-4;x++){q+=M.e[y*M.w+x];nn++;}mean=q/max(nn,1)+1e-9;N1=box(M.n,M.w,M.h,2);}
  vector<float> scx,scy,se;if(has&&(O.dirs)){se=box(MD.e,MD.w,MD.h,O.db);scx=box(MD.cx,MD.w,MD.h,O.db);scy=box(MD.cy,MD.w,MD.h,O.db);}
  // leaves
  double total=0;vector<uint64_t> off;vector<int> L;int b=M.lev-g; int bw=((cols-1)>>b)+1,bh=((rows-1)>>b)+1; // blocks in units of cells incl. rim of 2 cells
  vector<int> lev(bw*bh,0),ctx(bw*bh,0);
  auto mapidx=[&](int bx,int by){ // centre of block in pixels -> map index
    double px=(((bx+.5)*(1<<b))-2)*(1<<g),py=(((by+.5)*(1<<b))-2)*(1<<g);int mx=(int)floor(px/(1<<M.lev))+2,my=(int)floor(py/(1<<M.lev))+2;mx=min(max(mx,0),M.w-1);my=min(max(my,0),M.h-1);return my*M.w+mx;};
  if(O.leaf){
   for(int by=0;by<bh;by++)for(int bx=0;bx<bw;bx++){int q=by*bw+bx;double x0=((bx<<b)-2)*(double)(1<<g),y0=((by<<b)-2)*(double)(1<<g),sz=(double)(1<<(b+g));
     bool out=x0+sz<=0||y0+sz<=0||x0>=f.W||y0>=f.H;int id=mapidx(bx,by);int cx;
     if(out)cx=0;else if(!has)cx=1;else{int l1=(int)min(13.,max(0.,round(1.5*log2(M.e[id]/mean+1e-3)+9)));int l2=(int)min(7.,max(0.,round(1.5*log2(E2[id]/mean+1e-3)+4)));int l3=(int)min(9.,max(0.,round(1.5*log2(sm[id]/mean+1e-3)+6)));cx=2+(l1*8+l2)*10+l3;}
     ctx[q]=cx;}
   if(DUMP&&has){vector<int> num(bw*bh,0);for(size_t q=i;q<j;q++)num[(f.g[q].r>>b)*bw+(f.g[q].c>>b)]++;
    vector<float> cX=box(M.cx,M.w,M.h,1),cY=box(M.cy,M.w,M.h,1),E4=box(M.e,M.w,M.h,10),nA=box(M.n,M.w,M.h,1),nB=box(M.n,M.w,M.h,4);
    double nm=0;int nn=0;for(int y=2;y<M.h-4;y++)for(int x=2;x<M.w-4;x++){nm+=M.n[y*M.w+x];nn++;}nm=nm/nn+1e-9;
    auto at=[&](int bx,int by){return bx<0||by<0||bx>=bw||by>=bh?0:num[by*bw+bx];};
    for(int by=0;by<bh;by++)for(int bx=0;bx<bw;bx++){int q=by*bw+bx;if(ctx[q]==0)continue;int id=mapidx(bx,by);auto lg=[&](double x){return (float)log2(x/mean+1e-3);};
     int W1=M.w;float up[12]={(float)k,lg(M.e[id]),lg(sm[id]),lg(E2[id]),lg(E4[id]),lg(M.e[max(id-1,0)]),lg(M.e[min(id+1,M.w*M.h-1)]),lg(M.e[max(id-W1,0)]),lg(M.e[min(id+W1,M.w*M.h-1)]),(float)(hypot(cX[id],cY[id])/(sm[id]*1+1e-9)),(float)log2(nA[id]/nm+.01),(float)log2(nB[id]/nm+.01)};
     double wide=0;for(int dy=-4;dy<0;dy++)for(int dx=-4;dx<=4;dx++)wide+=at(bx+dx,by+dy);for(int dx=-4;dx<0;dx++)wide+=at(bx+dx,by);
     double dens=c/(double)((f.W*(double)f.H)/pow(4.,b+g));
     float more[10]={(float)at(bx-1,by),(float)at(bx,by-1),(float)at(bx-1,by-1),(float)at(bx+1,by-1),(float)wide,(float)dens,(float)log2(mean+1e-9),(float)num[q],(float)dens,(float)FI};
     fwrite(up,4,12,DUMP);fwrite(more,4,10,DUMP);}}
   auto&T=DT[kgrp(k)];if(T.empty())T.resize(2+14*8*10,{0,0});
   if(TRAIN){vector<int> num(bw*bh,0);for(size_t q=i;q<j;q++)num[(f.g[q].r>>b)*bw+(f.g[q].c>>b)]++;for(size_t q=0;q<num.size();q++){T[ctx[q]][0]+=num[q];T[ctx[q]][1]+=c/(double)((f.W*(double)f.H)/pow(4.,b+g));}}
   for(size_t q=0;q<ctx.size();q++){double rel=(T[ctx[q]][0]+1)/(T[ctx[q]][1]+1);int l=(int)round(log2(rel));l=min(max(l,-2*b-(ctx[q]==0?0:0)),(int)O.maxl);l=max(l,-O.minl);l=max(l,-2*b);lev[q]=l;}
  }
  if(O.leaf&&!TRAIN){auto&T=DT[kgrp(k)];double Z=0;for(auto q:ctx)Z+=(q==0?0:1)*(T[q][0]+1)/(T[q][1]+1);for(size_t q=i;q<j;q++){int id=(f.g[q].r>>b)*bw+(f.g[q].c>>b);double rel=(T[ctx[id]][0]+1)/(T[ctx[id]][1]+1);if(ctx[id]==0)rel=1e-3;ideal+=-log2(rel/Z)+2*b+f.g[q].px+f.g[q].py;}ideal-=lgamma(c+1.)/log(2.);
   double un=0;for(auto q:ctx)un+=q!=0;unif+=c*(log2(un)+2*b)-lgamma(c+1.)/log(2.);for(size_t q=i;q<j;q++)unif+=f.g[q].px+f.g[q].py;}
  vector<pair<uint64_t,int>> order;for(int by=0;by<bh;by++)for(int bx=0;bx<bw;bx++)order.push_back({O.net?(uint64_t)by*bw+bx:morton(bx,by),by*bw+bx});sort(order.begin(),order.end());
  vector<double> start(bw*bh);double total0=0;
  if(O.net&&NET.ok&&has&&!TRAIN){vector<int> num(bw*bh,0);for(size_t q=i;q<j;q++)num[(f.g[q].r>>b)*bw+(f.g[q].c>>b)]++;int kk=min(max(k+4,0),13);
    vector<float> cX=box(M.cx,M.w,M.h,1),cY=box(M.cy,M.w,M.h,1),E4=box(M.e,M.w,M.h,10);double dens=c/(double)((f.W*(double)f.H)/pow(4.,b+g));
    auto at=[&](int bx,int by){return bx<0||by<0||bx>=bw||by>=bh?0:num[by*bw+bx];};auto R=[](float v){return roundf(v*O.fq)/O.fq;};
    for(auto&o:order){int q=o.second,bx=q%bw,by=q/bw;if(ctx[q]==0){lev[q]=-min(2*b,O.minl);continue;}int id=mapidx(bx,by);auto lg=[&](double x){return R((float)log2(x/mean+1e-3));};int W1=M.w;
     float x[9]={lg(M.e[id]),lg(sm[id]),lg(E2[id]),lg(E4[id]),lg(M.e[max(id-1,0)]),lg(M.e[min(id+1,M.w*M.h-1)]),lg(M.e[max(id-W1,0)]),lg(M.e[min(id+W1,M.w*M.h-1)]),R((float)(hypot(cX[id],cY[id])/(sm[id]*1+1e-9)))};
     double wide=0;for(int dy=-4;dy<0;dy++)for(int dx=-4;dx<=4;dx++)wide+=at(bx+dx,by+dy);for(int dx=-4;dx<0;dx++)wide+=at(bx+dx,by);
     auto lo=[&](double v){return R((float)log2(v/max(dens,1e-4)+.3));};
     float y[6]={lo(at(bx-1,by)),lo(at(bx,by-1)),lo(at(bx-1,by-1)),lo(at(bx+1,by-1)),lo(wide),(float)log2(dens+1e-4)};
     float z[6]={lo(dens),lo(dens),lo(dens),lo(dens),lo(40*dens),y[5]};
     float le=NET.e(kk,x),l=le+NET.o(kk,y);double rel=exp(l),rel0=exp(le+NET.o(kk,z));idl+=num[q]*(l/log(2.)+log2(dens))-rel*dens/log(2.);
     double offs=O.T?log2(dens*pow(2.,O.T))-2*b:0;auto Q=[&](double r){int L=(int)round(log2(r)+offs);return max(max(min(L,(int)O.maxl),-O.minl),-2*b);};lev[q]=Q(rel);total0+=pow(2.,2*b+Q(rel0));}
  }
  for(auto&o:order){start[o.second]=total;total+=ctx[o.second]==0&&O.net?0:pow(2.,2*b+lev[o.second]);}
  if(O.leaf&&!TRAIN&&has){for(size_t q=i;q<j;q++){int id=(f.g[q].r>>b)*bw+(f.g[q].c>>b);qid+=-log2(pow(2.,2*b+lev[id])/total)+2*b+f.g[q].px+f.g[q].py;}qid-=lgamma(c+1.)/log(2.);qn+=c;}
  // distances
  vector<pair<double,int>> at;for(size_t q=i;q<j;q++){G&o=f.g[q];int bx=o.c>>b,by=o.r>>b,id=by*bw+bx;int bits=2*b+lev[id];int nx=bits/2,ny=(bits+1)/2;
    // position in block: b+px bits in x
    uint64_t X=((uint64_t)(o.c&((1<<b)-1))<<o.px)|o.X,Y=((uint64_t)(o.r&((1<<b)-1))<<o.py)|o.Y;int bx_=b+o.px,by_=b+o.py;
    unsigned ix=nx<=bx_?X>>(bx_-nx):X<<(nx-bx_),iy=ny<=by_?Y>>(by_-ny):Y<<(ny-by_);
    at.push_back({start[id]+(double)morton(0,0)+0,(int)q});
    // interleave nx and ny bits, y is the higher
    uint64_t mm=0;for(int z=0;z<ny;z++){mm|=(uint64_t)(iy>>z&1)<<(2*z+(ny==nx?1:0));}for(int z=0;z<nx;z++)mm|=(uint64_t)(ix>>z&1)<<(2*z+(ny==nx?0:1));
    at.back().first=start[id]+(double)mm;B.pos+=max(0,bx_-nx)+max(0,by_-ny);if(!TRAIN)wst+=max(0,nx-bx_)+max(0,ny-by_);}
  double cells=O.leaf?(total0>0?total0:total):(double)cols*rows;
  int t=0;for(uint64_t q=(uint64_t)(cells/c);q>=8;q/=2)t++;t=min(t,24);
  if(!O.leaf){at.clear();for(size_t q=i;q<j;q++)at.push_back({(double)morton(f.g[q].c,f.g[q].r),(int)q});B.pos=B.pos;}
  sort(at.begin(),at.end());
  double last=0;
  for(auto&p:at){G&o=f.g[p.second];uint64_t by=(uint64_t)(p.first-last);last=p.first;unsigned d=by>>t;B.dist+=dist.code(0,symof(d))+restof(symof(d),d);B.raw+=t;
   // colour
   int y=abs(o.y),A=abs(o.a),Bb=abs(o.b);auto lv=[](int s){return (s>0)+(s>2)+(s>5);};int sy=symof(y),sa=symof(A),sb=symof(Bb);
   int bx=o.c>>b,byy=o.r>>b;
   int dc=0;if(O.dirs&&has){int mx=min(max((int)floor(o.x/(1<<MD.lev))+2,0),MD.w-1),my=min(max((int)floor(o.yy_/(1<<MD.lev))+2,0),MD.h-1);int id=my*MD.w+mx;dc=1+dirctx(scx[id],scy[id],se[id]);}
   int bu=min(o.h,7);int sv=symof(abs(o.v)),sr=symof(abs(o.rr));int fold=0;if(dc>1){int cb=(dc-2)/8,an=(dc-2)%8;fold=1+cb*3+((an&1)?1:(an&2)?2:0);}
   int kk=min(max(k+4,0),13);auto mg=[](int s){return s==0?0:s<=2?1:s<=5?2:3;};
   int colored=(y!=0)<<2|(A!=0)<<1|(Bb!=0);int cbits=(o.y<0)<<2|(o.a<0)<<1|(o.b<0);int shaped=(o.v!=0)<<1|(o.rr!=0);int sbits=(o.v<0)<<1|(o.rr<0);
   bool own=O.own;
   vector<Ref> RL={{&luma,0,1}},RA={{&a,lv(sy),1}},RB={{&bb,lv(sa),1}},RC={{&cs,colored,1}},RV={{&v,bu,1}},RR={{&r,bu,1}},RS={{&ss,shaped,1}};
   if(O.own==2){RB.push_back({&bb2,mg(sa),1});RB.push_back({&bb1,mg(sa)*4+mg(sy),1});RR.push_back({&br1,bu*6+min(5,(sv+1)/2),1});RA.push_back({&ba1,mg(sy)*4+min(kk/4,3),1});own=false;}
   if(own){RL.push_back({&bl1,kk,1});RA.push_back({&ba1,kk*16+min(sy,15),1});RB.push_back({&bb1,mg(sa)*16+sy,1});RB.push_back({&bb2,kk*4+mg(sa),1});RC.push_back({&bc1,kk*8+colored,1});
     RV.push_back({&bv1,kk*8+bu,1});RR.push_back({&br1,bu*16+sv,1});RR.push_back({&br2,kk*8+bu,1});}
   if(O.dirs){RV.push_back({&vd,bu*10+fold,1});RR.push_back({&rd,bu*10+fold,1});RS={{&ss,shaped,.25},{&ssd,shaped*26+dc,.75}};
     if(own){RR.push_back({&rd2,(bu*10+fold)*5+min(4,sv/2),1});RS={{&ss,shaped,.2},{&ssd,shaped*26+dc,.4},{&ss2,((min(sv,7)/2)*4+min(sr,7)/2)*26+dc,.4}};}}
   else if(own)RS.push_back({&ss3,min(sv,7)*8+min(sr,7),1});
   LW*w0=O.mix>=2?&W_[0]:nullptr;auto w=[&](int i){if(w0)w0[i].id=i;return w0?w0+i:nullptr;};
   B.luma+=codeM(RL,sy,w(0))+restof(sy,y);if(!f.grey){B.a+=codeM(RA,sa,w(1))+restof(sa,A);B.b+=codeM(RB,sb,w(2))+restof(sb,Bb);}
   B.csign+=codeM(RC,cbits,w(3));B.v+=codeM(RV,sv,w(4))+restof(sv,abs(o.v));if(!f.upright)B.r+=codeM(RR,sr,w(5))+restof(sr,abs(o.rr));
   B.u+=o.ub;B.ssign+=codeM(RS,sbits,w(6));
   if(!O.leaf)B.pos+=0;
  }
  if(!O.leaf){ }
  if(O.pic){for(size_t q=i;q<j;q++)P.add(f.g[q]);}else for(size_t q=i;q<j;q++){M.add(f.g[q]);MD.add(f.g[q]);}
  i=j;}
 return B;}
int main(int argc,char**argv){
 string train=argv[1];vector<string> tests;
 for(int i=2;i<argc;i++){string s=argv[i];auto e=s.find('=');if(e==string::npos){tests.push_back(s);continue;}string k=s.substr(0,e);double v=atof(s.c_str()+e+1);
  if(k=="leaf")O.leaf=v;else if(k=="dirs")O.dirs=v;else if(k=="mix")O.mix=v;else if(k=="minblk")O.minblk=v;else if(k=="maxl")O.maxl=v;else if(k=="net")O.net=v;else if(k=="fq")O.fq=v;else if(k=="T")O.T=v;else if(k=="mind")O.mind=v;else if(k=="db")O.db=v;else if(k=="minb")O.minb=v;else if(k=="near")O.near=v;else if(k=="na")O.na=v;else if(k=="ps")O.ps=v;else if(k=="minl")O.minl=v;else if(k=="own")O.own=v;else if(k=="pic")O.pic=v;else if(k=="minpic")O.minpic=v;}
 auto listed=[&](const string&d){vector<File> o;FILE*p=popen(("ls "+d+"/*.bin").c_str(),"r");char buf[999];while(fgets(buf,999,p)){string s=buf;s.pop_back();o.push_back(load(s));}pclose(p);return o;};
 TRAIN=true;string tr=train;for(size_t q;(q=tr.find(','))!=string::npos;){for(auto&f:listed(tr.substr(0,q)))run(f);tr=tr.substr(q+1);}for(auto&f:listed(tr))run(f);
 if(O.near&&!O.net){for(int q=20;q<60;q++)DT[q].clear();auto save=ST;PASS2=true;for(int q=0;q<20;q++)for(auto&x:DT[q]){}  auto keep=vector<vector<array<double,2>>>(DT,DT+20);string t2=train;vector<File> fs;while(true){size_t q=t2.find(',');for(auto&f:listed(t2.substr(0,q)))run(f);if(q==string::npos)break;t2=t2.substr(q+1);}for(int q=0;q<20;q++)DT[q]=keep[q];ST=save;}
 NET.load(getenv("NET")?getenv("NET"):"net.bin");
 ST.finish();TRAIN=false;if(O.mix==3){for(auto&r:EW)for(double&x:r)x=.34;EM=true;for(int it=0;it<40;it++){memset(EN,0,sizeof EN);string t2=train;while(true){size_t q=t2.find(',');int z=0;for(auto&f:listed(t2.substr(0,q)))if(z++%12==it%12)run(f);if(q==string::npos)break;t2=t2.substr(q+1);}for(int i=0;i<16;i++){double t=0;for(double x:EN[i])t+=x;if(t>0)for(int m=0;m<8;m++)EW[i][m]=EN[i][m]/t;}}EM=false;for(int i=0;i<7;i++)printf("w%d %.2f %.2f %.2f | ",i,EW[i][0],EW[i][1],EW[i][2]);puts("");ideal=unif=wst=qid=qn=idl=0;}
 for(auto&d:tests){Bits s{};double n=0,pay=0,tot=0,size=0;int nf=0;if(getenv("DUMP"))DUMP=fopen(getenv("DUMP"),"wb");for(auto&f:listed(d)){FI++;Bits b=run(f);double*x=(double*)&s,*y=(double*)&b;for(int q=0;q<12;q++)x[q]+=y[q];n+=f.g.size();pay+=8.*f.payload;size+=8.*f.size;tot+=b.sum();nf++;}
  if(O.leaf)printf("waste %.3f quantised ideal %.3f of %.0f idl %.3f\n",wst/n,qid/qn,qn,idl/qn);
 if(O.leaf)printf("place: ideal of table %.3f uniform %.3f  ",ideal/n,unif/n);
 if(O.pic)printf("ops per gaussian %.1f  ",Pic::ops/n);
 printf("%s files %d gauss %.0f payload %.3f modelled %.3f file %.3f | place %.3f (dist %.3f raw %.3f pos %.3f) csign %.3f ssign %.3f v %.3f r %.3f luma %.3f a %.3f b %.3f u %.3f cnt %.3f\n",d.c_str(),nf,n,pay/n,tot/n,size/n,(s.dist+s.raw+s.pos)/n,s.dist/n,s.raw/n,s.pos/n,s.csign/n,s.ssign/n,s.v/n,s.r/n,s.luma/n,s.a/n,s.b/n,s.u/n,s.cnt/n);}
}
