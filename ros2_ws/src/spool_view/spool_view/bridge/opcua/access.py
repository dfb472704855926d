"""Access of OPC UA clients: they look and subscribe, and change nothing."""

from __future__ import annotations

from asyncua import ua
from asyncua.crypto.permission_rules import PermissionRuleset, User, UserRole
from asyncua.server.user_managers import UserManager

_IDS = ua.ObjectIds
#: Requests that are answered; writing, calling methods, history and changes of the address space are not.
ALLOWED = frozenset(
    ua.NodeId(number)
    for number in (
        _IDS.CreateSessionRequest_Encoding_DefaultBinary,
        _IDS.CloseSessionRequest_Encoding_DefaultBinary,
        _IDS.ActivateSessionRequest_Encoding_DefaultBinary,
        _IDS.CloseSecureChannelRequest_Encoding_DefaultBinary,
        _IDS.FindServersRequest_Encoding_DefaultBinary,
        _IDS.GetEndpointsRequest_Encoding_DefaultBinary,
        _IDS.ReadRequest_Encoding_DefaultBinary,
        _IDS.BrowseRequest_Encoding_DefaultBinary,
        _IDS.TranslateBrowsePathsToNodeIdsRequest_Encoding_DefaultBinary,
        _IDS.RegisterNodesRequest_Encoding_DefaultBinary,
        _IDS.UnregisterNodesRequest_Encoding_DefaultBinary,
        _IDS.CreateSubscriptionRequest_Encoding_DefaultBinary,
        _IDS.ModifySubscriptionRequest_Encoding_DefaultBinary,
        _IDS.DeleteSubscriptionsRequest_Encoding_DefaultBinary,
        _IDS.CreateMonitoredItemsRequest_Encoding_DefaultBinary,
        _IDS.DeleteMonitoredItemsRequest_Encoding_DefaultBinary,
        _IDS.SetMonitoringModeRequest_Encoding_DefaultBinary,
        _IDS.SetPublishingModeRequest_Encoding_DefaultBinary,
        _IDS.PublishRequest_Encoding_DefaultBinary,
        _IDS.RepublishRequest_Encoding_DefaultBinary,
    )
)


class LookOnly(PermissionRuleset):  # type: ignore[misc]  # asyncua carries no types
    """Ruleset of requests: those in ``ALLOWED``, from any client."""

    def check_validity(self, user: object, action_type: ua.NodeId, body: object) -> bool:  # noqa: ARG002
        """Return whether a request of that type is answered."""
        return action_type in ALLOWED


class Onlookers(UserManager):  # type: ignore[misc]  # asyncua carries no types
    """User manager by whom nobody is an administrator, whatever name is given."""

    def get_user(self, *_: object, **__: object) -> User:
        """Return a user without any rights of administration."""
        return User(role=UserRole.User)
