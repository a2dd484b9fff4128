"""What parts and numbers of profiles rd and paper are worth: python -m benchmarks.ablation"""
