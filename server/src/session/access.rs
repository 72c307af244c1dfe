//! Who may use what: the token, and the origins that pages may come from.

use crate::config::{Config, Token};
use crate::http::problem::Problem;
use axum::extract::{ConnectInfo, Request, State};
use axum::http::header::{AUTHORIZATION, HOST, HeaderValue, ORIGIN, SEC_WEBSOCKET_PROTOCOL, WWW_AUTHENTICATE};
use axum::http::{HeaderMap, StatusCode, Uri};
use axum::middleware::Next;
use axum::response::{IntoResponse as _, Response};
use base64::Engine as _;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::sync::Arc;

/// A subprotocol that carries the token, base64url without padding, because a page cannot set headers of a WebSocket.
const TOKEN_PROTOCOL: &str = "foresight.token.";

/// Who may use what.
#[derive(Clone, Debug)]
pub struct Access {
    token: Option<Token>,
    origins: Vec<String>,
    guard_worlds: bool,
    proxies: Vec<IpAddr>,
}

impl Access {
    /// As configured.
    pub fn new(config: &Config, token: Option<Token>) -> Access {
        Access {
            token,
            origins: config.origin.iter().map(|origin| origin.0.clone()).collect(),
            guard_worlds: config.guard_worlds,
            proxies: config.trusted_proxy.clone(),
        }
    }

    /// Whether a path is for those with the token only.
    fn guards(&self, path: &str) -> bool {
        let below = |root: &str| path == root || path.strip_prefix(root).is_some_and(|rest| rest.starts_with('/'));
        below("/sessions") || below("/admin") || path == "/metrics" || (self.guard_worlds && below("/worlds"))
    }

    fn has_token(&self, headers: &HeaderMap, uri: &Uri) -> bool {
        let Some(token) = &self.token else { return true };
        let bearer = headers.get(AUTHORIZATION).and_then(|value| value.to_str().ok()).and_then(|value| {
            let (scheme, token) = value.split_once(' ')?;
            scheme.eq_ignore_ascii_case("bearer").then(|| token.trim().to_owned())
        });
        let offered = headers.get_all(SEC_WEBSOCKET_PROTOCOL).iter().filter_map(|value| value.to_str().ok());
        let protocol = offered.flat_map(|value| value.split(',')).find_map(|protocol| {
            let encoded = protocol.trim().strip_prefix(TOKEN_PROTOCOL)?;
            String::from_utf8(base64::engine::general_purpose::URL_SAFE_NO_PAD.decode(encoded).ok()?).ok()
        });
        let query = uri.query().unwrap_or_default().split('&').find_map(|pair| {
            let value = pair.strip_prefix("token=")?;
            percent_encoding::percent_decode_str(value).decode_utf8().ok().map(std::borrow::Cow::into_owned)
        });
        [bearer, protocol, query].into_iter().flatten().any(|text| token.matches(&text))
    }

    /// Whether a page of this origin may. Without a token any host name could lead to this machine, so then the page has to
    /// come from loopback itself, or be listed.
    fn takes_origin(&self, headers: &HeaderMap) -> bool {
        let Some(origin) = headers.get(ORIGIN) else { return true };
        let Ok(origin) = origin.to_str().map(str::to_ascii_lowercase) else { return false };
        if self.origins.contains(&origin) {
            return true;
        }
        let Some(authority) = origin.strip_prefix("http://").or_else(|| origin.strip_prefix("https://")) else {
            return false;
        };
        let same = headers.get(HOST).and_then(|host| host.to_str().ok()).is_some_and(|host| host == authority);
        is_loopback(authority) || (same && self.token.is_some())
    }

    /// The address that a request counts for: the peer's, or where the peer is a trusted proxy the last that it names.
    fn client(&self, peer: IpAddr, headers: &HeaderMap) -> IpAddr {
        if !self.proxies.contains(&peer) {
            return peer;
        }
        let named = headers.get_all("x-forwarded-for").iter().filter_map(|value| value.to_str().ok()).next_back();
        let last = named.and_then(|value| value.rsplit(',').next()).and_then(|address| address.trim().parse().ok());
        last.unwrap_or(peer)
    }
}

/// Whether the host of `HOST[:PORT]` is this machine.
fn is_loopback(authority: &str) -> bool {
    let host = match authority.strip_prefix('[') {
        Some(rest) => rest.split(']').next().unwrap_or_default(),
        None => authority.split(':').next().unwrap_or_default(),
    };
    host == "localhost" || host.parse::<IpAddr>().is_ok_and(|address| address.is_loopback())
}

/// The address that a request counts for.
#[derive(Clone, Copy, Debug)]
pub(super) struct Client(pub(super) IpAddr);

/// Refuses requests without the token, and those of pages that must not send them; notes whose request it is.
pub async fn guard(State(access): State<Arc<Access>>, mut request: Request, next: Next) -> Response {
    let path = request.uri().path();
    if access.guards(path) {
        if !access.takes_origin(request.headers()) {
            let detail =
                "pages of this origin may not; expected the server's own or one that the setting `origin` lists";
            return Problem::new(StatusCode::FORBIDDEN, detail).into_response();
        }
        if !access.has_token(request.headers(), request.uri()) {
            let detail = "expected the server's token: Authorization: Bearer TOKEN, for a page's WebSocket the subprotocol \
                          foresight.token.BASE64URL, or ?token=TOKEN";
            let problem = Problem::new(StatusCode::UNAUTHORIZED, detail);
            return problem.with(WWW_AUTHENTICATE, HeaderValue::from_static("Bearer")).into_response();
        }
    }
    let peer = request.extensions().get::<ConnectInfo<SocketAddr>>();
    let peer = peer.map_or(IpAddr::V4(Ipv4Addr::UNSPECIFIED), |peer| peer.0.ip().to_canonical());
    let client = Client(access.client(peer, request.headers()));
    request.extensions_mut().insert(client);
    next.run(request).await
}

#[cfg(test)]
mod tests {
    use super::*;

    fn access(token: Option<&str>, origins: &[&str]) -> Access {
        Access {
            token: token.map(|token| Token::new(token).expect("a token")),
            origins: origins.iter().map(|origin| (*origin).to_owned()).collect(),
            guard_worlds: false,
            proxies: vec![IpAddr::V4(Ipv4Addr::LOCALHOST)],
        }
    }

    fn headers(pairs: &[(&'static str, &str)]) -> HeaderMap {
        pairs.iter().map(|(name, value)| (name.parse().unwrap(), value.parse().unwrap())).collect()
    }

    #[test]
    fn a_token_comes_three_ways() {
        let access = access(Some("0123456789abcdef/="), &[]);
        let has = |pairs: &[(&'static str, &str)], uri: &str| access.has_token(&headers(pairs), &uri.parse().unwrap());
        let encoded = base64::engine::general_purpose::URL_SAFE_NO_PAD.encode("0123456789abcdef/=");
        assert!(has(&[("authorization", "bearer 0123456789abcdef/=")], "/sessions"));
        let protocols = format!("foresight.json.v1, foresight.token.{encoded}");
        assert!(has(&[("sec-websocket-protocol", &protocols)], "/sessions"));
        assert!(has(&[], "/sessions?a=b&token=0123456789abcdef%2F%3D"));
        assert!(!has(&[], "/sessions"));
        assert!(!has(&[("authorization", "Bearer 0123456789abcdef")], "/sessions?token="));
        assert!(!has(&[("authorization", "Basic 0123456789abcdef/=")], "/sessions"));
    }

    #[test]
    fn origins() {
        let open = access(None, &["https://maps.example"]);
        let takes = |access: &Access, origin: &str, host: &str| {
            access.takes_origin(&headers(&[("origin", origin), ("host", host)]))
        };
        assert!(open.takes_origin(&headers(&[("host", "x")])));
        for good in ["http://localhost:3000", "http://127.0.0.1:8080", "https://[::1]:1", "https://MAPS.example"] {
            assert!(takes(&open, good, "127.0.0.1:8080"), "{good}");
        }
        for bad in ["null", "https://evil.example", "http://localhost.evil.example", "http://127.0.0.1.evil", "file://"]
        {
            assert!(!takes(&open, bad, "127.0.0.1:8080"), "{bad}");
        }
        // A name that was made to point here.
        assert!(!takes(&open, "http://evil.example:8080", "evil.example:8080"));
        assert!(takes(&access(Some("0123456789abcdef"), &[]), "http://own.example", "own.example"));
    }

    #[test]
    fn only_a_trusted_proxy_names_its_client() {
        let access = access(None, &[]);
        let forwarded = headers(&[("x-forwarded-for", "1.1.1.1, 2.2.2.2")]);
        let proxy = IpAddr::V4(Ipv4Addr::LOCALHOST);
        assert_eq!(access.client(proxy, &forwarded), IpAddr::from([2, 2, 2, 2]));
        assert_eq!(access.client(IpAddr::from([3, 3, 3, 3]), &forwarded), IpAddr::from([3, 3, 3, 3]));
        assert_eq!(access.client(proxy, &HeaderMap::new()), proxy);
    }
}
