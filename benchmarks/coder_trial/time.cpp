// How long do map, net and walk take? Float proxies with the operations of an integer version.
#define main main_
#include "lengths.cpp"
#undef main
#include <chrono>
#include <immintrin.h>
static double now(){return chrono::duration<double>(chrono::steady_clock::now().time_since_epoch()).count();}
static inline float flog2(float x){int i;memcpy(&i,&x,4);return (i-1065353216)*(1.f/8388608);} // piecewise linear
static double tmap=0,tbox=0,tnet=0,twalk=0;static long nb_=0,nsp=0;
static void boxf(const float*a,float*o,int w,int h,int r,float*t){ // separable running sums, rows vectorised down columns
 for(int y=0;y<h;y++){float s=0;const float*p=a+y*w;for(int x=0;x<min(r,w);x++)s+=p[x];for(int x=0;x<w;x++){if(x+r<w)s+=p[x+r];if(x-r-1>=0)s-=p[x-r-1];t[y*w+x]=s;}}
 vector<float> s(w,0.f);for(int y=0;y<min(r,h);y++)for(int x=0;x<w;x++)s[x]+=t[y*w+x];for(int y=0;y<h;y++){float*q=o+y*w;if(y+r<h){const float*p=t+(y+r)*w;for(int x=0;x<w;x++)s[x]+=p[x];}if(y-r-1>=0){const float*p=t+(y-r-1)*w;for(int x=0;x<w;x++)s[x]-=p[x];}for(int x=0;x<w;x++)q[x]=s[x];}}
static void file(File&f){Map M;M.init(7,f.W,f.H);size_t i=0;int n=f.g.size();
 for(int k=f.g[0].k;k>=f.g[n-1].k;k--){size_t j=i;while(j<f.g.size()&&f.g[j].k==k)j++;int c=j-i;if(!c)continue;int g=gof(k),L=max(g,3);double t0=now();if(M.lev>L)M.down(L,f.W,f.H);double t1=now();tmap+=t1-t0;
  int w=M.w,h=M.h,N=w*h;static vector<float> sm,E2,E4,cX,cY,t,pre[8],o;sm.resize(N);E2.resize(N);E4.resize(N);cX.resize(N);cY.resize(N);t.resize(N);o.assign(N,0);
  boxf(M.e.data(),sm.data(),w,h,1,t.data());boxf(M.e.data(),E2.data(),w,h,4,t.data());boxf(M.e.data(),E4.data(),w,h,10,t.data());boxf(M.cx.data(),cX.data(),w,h,1,t.data());boxf(M.cy.data(),cY.data(),w,h,1,t.data());
  double t2=now();tbox+=t2-t1;
  static vector<float> le,ls,l2,l4,co;le.resize(N+2*w+2);ls.resize(N);l2.resize(N);l4.resize(N);co.resize(N);float*LE=le.data()+w+1;
  for(int q=0;q<N;q++){LE[q]=flog2(M.e[q]+1e-3f);ls[q]=flog2(sm[q]+1e-3f);l2[q]=flog2(E2[q]+1e-3f);l4[q]=flog2(E4[q]+1e-3f);co[q]=(fabsf(cX[q])+fabsf(cY[q]))/(sm[q]+1e-9f);}
  for(int hh=0;hh<8;hh++){const float*W=&NET.W1[hh*9];float b=NET.b1[hh],w2=NET.w2[hh];for(int q=0;q<N;q++){float a=b+W[0]*LE[q]+W[1]*ls[q]+W[2]*l2[q]+W[3]*l4[q]+W[4]*LE[q-1]+W[5]*LE[q+1]+W[6]*LE[q-w]+W[7]*LE[q+w]+W[8]*co[q];o[q]+=w2*max(a,0.f);}}
  double t3=now();tnet+=t3-t2;nb_+=N;
  // walk: counts pushed to neighbours, a table by (s1,s2), leaves and prefix
  static vector<int> s1,s2;s1.assign(N,0);s2.assign(N,0);static int tab[32][64];static int lv[64];for(int a=0;a<64;a++)lv[a]=1<<(a&7);
  vector<int> bl;for(size_t q=i;q<j;q++){int mx=min(max((int)floor(f.g[q].x/(1<<L))+2,0),w-1),my=min(max((int)floor(f.g[q].yy_/(1<<L))+2,0),h-1);bl.push_back(my*w+mx);}sort(bl.begin(),bl.end());
  double t4=now();long pos=0;int q=0;volatile long sink;for(int target:bl){for(;q<target;q++){int l=(int)(o[q]*1.44f)+tab[min(s1[q],31)][min(s2[q],63)];pos+=lv[l&63];}
    // push
    if(target%w>5&&target%w<w-6&&target+4*w+5<N){s1[target+1]+=2;s1[target+w]+=2;s1[target+w+1]++;s1[target+w-1]++;for(int d=1;d<=4;d++)s2[target+d]++;for(int y=1;y<=4;y++)for(int x=-4;x<=4;x++)s2[target+y*w+x]++;}}
  sink=pos;double t5=now();twalk+=t5-t4;
  for(size_t q=i;q<j;q++)M.add(f.g[q]);tmap+=now()-t5;i=j;}}
int main(int argc,char**argv){NET.load("net.bin");vector<File> fs;FILE*p=popen((string("ls ")+argv[1]+"/*.bin").c_str(),"r");char buf[999];while(fgets(buf,999,p)){string s=buf;s.pop_back();fs.push_back(load(s));}
 double best[5]={9,9,9,9,9};for(int r=0;r<9;r++){tmap=tbox=tnet=twalk=0;nb_=0;for(auto&f:fs)file(f);double v[5]={tmap,tbox,tnet,twalk,tmap+tbox+tnet+twalk};for(int z=0;z<5;z++)best[z]=min(best[z],v[z]/fs.size()*1e3);}
 printf("ms a file: map %.3f box %.3f net %.3f walk %.3f sum %.3f, blocks %ld\n",best[0],best[1],best[2],best[3],best[4],nb_/(long)fs.size());}
