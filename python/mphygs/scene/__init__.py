"""The object at rest: quadrature points, exposed surface, attachments."""
