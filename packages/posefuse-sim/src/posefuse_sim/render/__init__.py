"""The scene drawn: OpenGL without a screen, real lenses and shutters, several processes."""
