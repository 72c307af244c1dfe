//! The client for browsers: `/foresight.js`, a module that pages of any origin can import, and `/fly/`, a page that drives
//! it and shows what arrives. `/fly/?self-test=SECONDS` flies by itself and writes what became of it into the page.
//!
//! All of it is in the binary. The page loads nothing from elsewhere, and runs no script but its own modules.

use axum::Router;
use axum::http::header::{
    CACHE_CONTROL, CONTENT_SECURITY_POLICY, CONTENT_TYPE, ETAG, HeaderName, IF_NONE_MATCH, REFERRER_POLICY,
    X_CONTENT_TYPE_OPTIONS,
};
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Redirect, Response};
use axum::routing::get;

/// What the page may load and run: what this server has.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; base-uri 'none'; \
                      form-action 'none'; frame-ancestors 'none'";

/// A file in the binary.
struct Asset {
    address: &'static str,
    media_type: &'static str,
    text: &'static str,
}

const SCRIPT: &str = "text/javascript; charset=utf-8";
static ASSETS: [Asset; 7] = [
    Asset { address: "/foresight.js", media_type: SCRIPT, text: include_str!("foresight.js") },
    Asset { address: "/fly/", media_type: "text/html; charset=utf-8", text: include_str!("fly.html") },
    Asset { address: "/fly/fly.css", media_type: "text/css; charset=utf-8", text: include_str!("fly.css") },
    Asset { address: "/fly/fly.js", media_type: SCRIPT, text: include_str!("fly.js") },
    Asset { address: "/fly/camera.js", media_type: SCRIPT, text: include_str!("camera.js") },
    Asset { address: "/fly/charts.js", media_type: SCRIPT, text: include_str!("charts.js") },
    Asset { address: "/fly/self_test.js", media_type: SCRIPT, text: include_str!("self_test.js") },
];

/// The addresses of the client for browsers; they need no state.
pub fn routes() -> Router {
    let fly = Router::new().route("/fly", get(|| async { Redirect::permanent("/fly/") }));
    ASSETS.iter().fold(fly, |router, asset| {
        let tag = format!("\"{}\"", &blake3::hash(asset.text.as_bytes()).to_hex()[..32]);
        let handler = get(move |headers: HeaderMap| async move { answer(asset, tag, &headers) });
        router.route(asset.address, handler)
    })
}

/// The file, or that it has not changed.
fn answer(asset: &'static Asset, tag: String, headers: &HeaderMap) -> Response {
    let known = headers.get_all(IF_NONE_MATCH).iter().filter_map(|value| value.to_str().ok());
    let mut known = known.flat_map(|value| value.split(',')).map(|tag| tag.trim().trim_start_matches("W/"));
    let is_known = known.any(|known| known == tag || known == "*");
    let common: [(HeaderName, String); 5] = [
        (ETAG, tag),
        (CACHE_CONTROL, "no-cache".to_owned()),
        (CONTENT_SECURITY_POLICY, POLICY.to_owned()),
        (REFERRER_POLICY, "no-referrer".to_owned()),
        (X_CONTENT_TYPE_OPTIONS, "nosniff".to_owned()),
    ];
    if is_known {
        return (StatusCode::NOT_MODIFIED, common).into_response();
    }
    (common, [(CONTENT_TYPE, asset.media_type)], asset.text).into_response()
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::body::Body;
    use axum::http::Request;
    use std::collections::BTreeSet;
    use tower::ServiceExt as _;

    async fn get(address: &str, tag: Option<&str>) -> Response {
        let request = Request::get(address);
        let request = if let Some(tag) = tag { request.header(IF_NONE_MATCH, tag) } else { request };
        routes().oneshot(request.body(Body::empty()).unwrap()).await.unwrap()
    }

    #[tokio::test]
    async fn files_are_served_once() {
        for asset in &ASSETS {
            let response = get(asset.address, None).await;
            assert_eq!(response.status(), StatusCode::OK, "{}", asset.address);
            assert_eq!(response.headers()[CONTENT_TYPE], asset.media_type);
            let tag = response.headers()[ETAG].to_str().unwrap().to_owned();
            for known in [tag.clone(), format!("\"other\", W/{tag}"), "*".to_owned()] {
                assert_eq!(get(asset.address, Some(&known)).await.status(), StatusCode::NOT_MODIFIED, "{known}");
            }
            assert_eq!(get(asset.address, Some("\"other\"")).await.status(), StatusCode::OK);
        }
        assert_eq!(get("/fly", None).await.status(), StatusCode::PERMANENT_REDIRECT);
    }

    /// What the page and its modules load is served, and nothing is written into the page that the policy forbids.
    #[test]
    fn the_page_loads_only_what_is_here() {
        let here: BTreeSet<&str> = ASSETS.iter().map(|asset| asset.address).collect();
        let mut loaded = 0;
        for asset in &ASSETS {
            for (before, after) in [("src=\"", '"'), ("href=\"", '"'), ("from \"", '"')] {
                // The module's documentation shows how others import it.
                let code = asset.text.lines().filter(|line| !line.trim_start().starts_with(['*', '/']));
                for line in code {
                    for rest in line.split(before).skip(1) {
                        let name = rest.split(after).next().unwrap_or_default();
                        let folder = &asset.address[..=asset.address.rfind('/').unwrap_or(0)];
                        let address = match name.strip_prefix("../") {
                            Some(name) => format!("/{name}"),
                            None => format!("{folder}{}", name.trim_start_matches("./")),
                        };
                        assert!(here.contains(&*address), "{} loads {name}", asset.address);
                        loaded += 1;
                    }
                }
            }
            let inline = [" style=", "<style", " onclick", " onload", "javascript:", "<script>", "eval(", "innerHTML"];
            assert!(!inline.iter().any(|forbidden| asset.text.contains(forbidden)), "{}", asset.address);
        }
        assert!(loaded >= 6, "{loaded}");
    }
}
