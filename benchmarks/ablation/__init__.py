"""What the parts of profile paper are worth: python -m benchmarks.ablation"""
