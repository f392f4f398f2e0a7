"""The flexible-model tracker (Hecht, Azad, Dillmann 2009): a body of masses and springs, particle filters, appearance.

Public: `entry.FlexibleTracker`, `flexible_body.flexible_body`, `physics.relax`.
"""
