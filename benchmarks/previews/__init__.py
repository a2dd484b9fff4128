"""The small end: files of 32 to 4,096 bytes, beside placeholders and codecs: python -m benchmarks.previews"""
