"""Every node of the package has this alike: parameters, QoS, signals, diagnostics,
lifecycle, services, its DDS domain.
"""
