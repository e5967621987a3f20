"""Assembly: scene to system, and the closing of a start on its joints."""
