"""Processes and how they end.

The supervisor starts the sandbox, the web process and the workers, and replaces those that die.
A signal to stop comes in, and reaches every loop; a child that lost its parent ends itself.
"""
