"""Processes and how they end.

The supervisor starts the sandbox, the web process and the workers, and replaces those that die. Every loop sees a
signal to stop, and a child whose parent has died ends itself.
"""
