"""The HTTP API: one list of routes (routes.py), and the application around it (app.py).

A request passes the middleware: it gets an id and a line in the log, its caller is identified, and its body is
limited. Then a handler answers it, or it is refused with a problem document.
"""
