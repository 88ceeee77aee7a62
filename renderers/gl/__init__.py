"""Drawing splats with OpenGL. Only the thread that owns the context may touch anything here."""
