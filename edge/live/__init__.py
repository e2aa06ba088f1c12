"""Live view: a web page that shows what the service sees, plans and does, and sends requests.

A sink keeps the data while a person views the page; they are encoded on request. The page in
`page/` is plain HTML, CSS and JavaScript. HTTP is in `edge.host.web_server`, the requests' actions
are in `edge.loop.requests.handlers`.
"""
