"""Kills and restarts at random while the service works, and the ledger after it: python -m benchmarks.chaos"""
