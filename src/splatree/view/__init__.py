"""The viewer: the cut of each view is made here, and the browser draws it.

server.py answers HTTP   files.py of the page   guard.py who may ask   connection.py of a page   client.py its worker
messages.py the protocol   pace.py what a slow line carries   options.py
exhibit.py a scene on show   slots.py what a page holds   pictures.py frames drawn here   boxes.py
viewer.py `view` and `Viewer`   page/ HTML, CSS and plain JavaScript modules
"""
