"""Cross-sectional maximum likelihood, batch and recursive (porter1983_partitioned_recursive).

Entry points: ``batch.batch_ml``, ``recursive.recursive_ml``. Tests and unknowns: ``problem``. One test: ``ignorant``,
``restoring`` and ``full``, on the kernel in ``differentiated``. Many tests: ``information``, ``evaluate``,
``correlated``. Maximisation: ``scoring``, ``admissible``.
"""
