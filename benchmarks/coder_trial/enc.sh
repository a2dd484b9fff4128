cd TRIAL
for r in 0.25 0.1 0.4; do for s in kodak:KODAK other:photos/measured train:train; do n=${s%%:*}; d=${s#*:}
mkdir -p sg/$n/$r; for p in $d/*.png; do b=$(basename $p .png); [ -e sg/$n/$r/$b.sg ] || SG_THREADS=1 nice -n 15 CHECKOUT/.venv/bin/python -c "
import sgmethod,sys
sgmethod.encode(sys.argv[1],bpp=float(sys.argv[2]),tune='psnr').save(sys.argv[3])" $p $r sg/$n/$r/$b.sg 2>/dev/null; done; echo $n $r $(date +%T); done; done
