"""What the kernels are tested against, slow and in float64: drawing (drawing.py), and a whole backend (backend.py)."""
