"""Access: keys, roles, the audit trail of refused requests.

Public: access_housekeeping, access_middleware, audit_context, auth, cross_origin, key_cache, principals,
refusal_audit, session_cookie.
"""
