"""A scene as a folder of parts."""
