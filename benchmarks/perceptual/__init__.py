"""LPIPS, DISTS and judges that chose nothing, the photographs that are measured, and sheets of crops."""
