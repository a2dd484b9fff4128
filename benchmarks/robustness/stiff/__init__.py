"""Profile rd on pictures that are hard for it, and the rules that every encode of them keeps."""
