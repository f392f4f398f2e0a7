"""The flexible-model tracker (Hecht, Azad, Dillmann 2009): masses and springs, particle filters on images.

Public: `entry.FlexibleTracker`, `flexible_body.flexible_body`, `physics.relax`.
"""
