"""Work of every kind for a long time, and whether anything grows: python -m benchmarks.soak"""
