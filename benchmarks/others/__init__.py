"""What the paper compares with and quotes, fitted here in plain torch: python -m benchmarks.others"""
