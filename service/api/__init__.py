"""The HTTP API: one list of routes (routes.py), and the application around it (app.py).

A request passes the gate (gate.py): it gets an id and a line in the log, its caller is identified, and its body is
limited. Then a handler in encode.py, decode.py, jobs.py or health.py answers it, or it is refused with a problem
document. Handlers share requests.py, which reads requests; context.py, the parts of the running service; turns.py, the
limits on concurrent work; and sending.py, which sends files that clients may keep.
"""
