"""LPIPS, DISTS and judges that chose nothing, the photographs that are measured, crops and a page for readers."""
