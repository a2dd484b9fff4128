"""The table of jobs, in SQLite or in PostgreSQL.

A job comes in once its image is stored.
Workers claim it, and write down how it went; interface.py says what every table must do.
"""
