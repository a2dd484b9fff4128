"""Rate and distortion over a folder of pictures, beside other codecs: python -m benchmarks.rd"""
