"""The service under load, attacked, and killed at random: python -m benchmarks.service"""
