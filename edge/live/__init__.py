"""The live view: a page that shows what the service sees, plans and does, and takes requests.

A sink keeps what the page shows, while somebody looks; it is encoded where it is asked for. The
page itself, in `page/`, is plain HTML, CSS and JavaScript. How HTTP works does not come in here
(`edge.host.pages`), nor what a request does (`edge.loop.requests`).
"""
