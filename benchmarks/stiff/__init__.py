"""Profile rd on pictures that are hard for it, and rules that every encode of them keeps: python -m benchmarks.stiff"""
