"""What software needs to know about a core, written in several languages from one description.

Every function takes the description of :func:`ukf_hdl.generate.description` and gives a text. Equal
descriptions give equal texts.
"""
