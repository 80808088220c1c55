"""What every node of the package does alike: parameters, QoS, signals, diagnostics,
lifecycle, services, its DDS domain.
"""
