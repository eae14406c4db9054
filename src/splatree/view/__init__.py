"""The viewer: the cut of each view is made here, and the browser draws it.

server.py answers HTTP and WebSockets   guard.py who may ask   client.py one worker for a page   messages.py the protocol
exhibit.py a scene on show   slots.py what a page holds   pictures.py frames drawn here   boxes.py
viewer.py `view` and `Viewer`   page/ HTML, CSS and plain JavaScript modules
"""
