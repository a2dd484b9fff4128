"""The job table, in SQLite or in PostgreSQL.

A job comes in once its image is stored. Workers claim the job and report the outcome; table.py says what every job
table must do.
"""
