"""The routes: what the service answers, and how.

Requests that passed the guards come in.
Jobs go to the table, images to the storage; views of them and drawn pictures leave.
"""
