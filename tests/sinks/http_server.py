#!/usr/bin/env python3
"""A server of HTTP that misbehaves as it is told: http_server.py FOLDER [CERTIFICATE KEY [CA]]

Serves 127.0.0.1, on the port that FOLDER/port says, else on a free one, which it writes there. FOLDER/mode says what it
does with each request, and is read for each anew:

  ok                    200
  status N [HEADERS] [-- TEXT]   that status, with headers "Name:value" and this text
  refuse V...           400 when one of the events has one of these values, else 200
  limit N               413 when the body is longer
  hang                  reads the request and never answers
  deaf                  reads nothing
  garbage               answers what is no HTTP
  drip                  answers a byte a second
  close                 closes the connection when it has read half of the body
  lost                  takes the events, and closes the connection without an answer
  half                  answers less than it has promised
  endless               answers without an end
  trickle               the same, a byte at a time
  gigabyte              answers 1 GB, as it has said
  answer [HEADERS]      200 with what FOLDER/answer holds; 304 when the request has its ETag
  chunked               the same in chunks
  digest                the same to "admin" with the password "s3cret", by digest (RFC 7616); else 401

What it took, and what it answered, is a JSON object a line in FOLDER/requests: method, path, headers, status, body.
"""
import gzip
import hashlib
import json
import os
import re
import socket
import ssl
import sys
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

folder = sys.argv[1]
lock = threading.Lock()


def mode():
    with open(os.path.join(folder, "mode")) as file:
        return file.read().split()


def values(body):
    """Of the events, in any of the shapes of JSON."""
    text = body.decode()
    events = json.loads(text) if text.startswith("[") else [json.loads(line) for line in text.splitlines()]
    return [event["data"]["value"] for event in events]


def content():
    with open(os.path.join(folder, "answer"), "rb") as file:
        return file.read()


def sha(text):
    return hashlib.sha256(text.encode()).hexdigest()


class Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    disable_nagle_algorithm = True
    wbufsize = -1  # headers and text in one packet

    def log_message(self, *_):
        pass

    def note(self, status, body):
        with lock, open(os.path.join(folder, "requests"), "a") as file:
            file.write(json.dumps({"method": self.command, "path": self.path, "headers": dict(self.headers.items()),
                                   "status": status, "port": self.client_address[1],
                                   "body": body.decode("latin-1")}) + "\n")

    def answer(self, status, body, headers=(), text=b""):
        self.note(status, body)
        self.send_response(status)
        for header in headers:
            self.send_header(*header.split(":", 1))
        self.send_header("Content-Length", str(len(text)))
        self.end_headers()
        self.wfile.write(text)
        self.wfile.flush()

    def raw(self, data):
        self.connection.sendall(data)

    def proves_itself(self):
        given = dict(re.findall(r'(\w+)="?([^",]*)"?', self.headers.get("Authorization", "")))
        proof = [sha("admin:here:s3cret"), given.get("nonce"), given.get("nc"), given.get("cnonce"), "auth",
                 sha(f"{self.command}:{self.path}")]
        return None not in proof and given.get("response") == sha(":".join(proof))

    def do_POST(self):
        words = mode()
        what = words[0]
        self.close_connection = False
        if what == "deaf":
            time.sleep(3600)
        length = int(self.headers.get("Content-Length", 0))
        if what == "limit" and length > int(words[1]):
            self.close_connection = True  # as servers do that do not read what they refuse
            return self.answer(413, b"", ["Connection:close"], b"too long\n")
        if what == "close":
            self.rfile.read(length // 2)
            self.note(0, b"")
            self.close_connection = True
            self.connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
            return self.connection.close()
        body = self.rfile.read(length)
        if self.headers.get("Content-Encoding") == "gzip":
            body = gzip.decompress(body)
        if what in ("hang", "lost", "garbage", "drip", "half", "endless", "trickle", "gigabyte", "chunked"):
            self.note(0, body)
        if what == "hang":
            time.sleep(3600)
        elif what == "lost":
            self.close_connection = True
        elif what == "garbage":
            self.raw(b"\x00\xffSSH-2.0-no server of HTTP\r\n\r\n")
            self.close_connection = True
        elif what == "drip":
            for byte in b"HTTP/1.1 200 OK\r\nContent-Length: 0\r\n\r\n":
                self.raw(bytes([byte]))
                time.sleep(1)
        elif what == "half":
            self.raw(b"HTTP/1.1 200 OK\r\nContent-Length: 100\r\n\r\nhalf of it")
            self.close_connection = True
        elif what == "endless":
            self.raw(b"HTTP/1.1 200 OK\r\n\r\n")
            while True:
                self.raw(b"x" * 65536)
        elif what == "trickle":
            self.raw(b"HTTP/1.1 200 OK\r\n\r\n")
            while True:
                self.raw(b"x")
                time.sleep(0.01)
        elif what == "gigabyte":
            self.raw(b"HTTP/1.1 200 OK\r\nContent-Length: 1000000000\r\n\r\n")
            for _ in range(10000):
                self.raw(b"x" * 100000)
        elif what == "chunked":
            self.raw(b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n")
            for byte in content():
                self.raw(b"1\r\n" + bytes([byte]) + b"\r\n")
            self.raw(b"0\r\n\r\n")
        elif what == "answer":
            etag = [header[5:] for header in words[1:] if header.startswith("ETag:")]
            if self.headers.get("If-None-Match") in etag:
                self.answer(304, body, words[1:])
            else:
                self.answer(200, body, words[1:], content())
        elif what == "digest":
            challenge = 'WWW-Authenticate:Digest realm="here", nonce="17", algorithm=SHA-256, qop="auth"'
            self.answer(*((200, body, (), content()) if self.proves_itself() else (401, body, [challenge])))
        elif what == "status":
            rest = words[2:]
            text = " ".join(rest[rest.index("--") + 1:]).encode() if "--" in rest else b""
            headers = rest[:rest.index("--")] if "--" in rest else rest
            self.answer(int(words[1]), body, headers, text)
        elif what == "refuse" and any(value in [float(word) for word in words[1:]] for value in values(body)):
            self.answer(400, body, (), b"this value\nis not taken here\n")
        else:
            self.answer(200, body, (), b"taken\n")

    do_PUT = do_POST
    do_GET = do_POST


class Server(ThreadingHTTPServer):
    daemon_threads = True
    request_queue_size = 64
    allow_reuse_address = True

    def handle_error(self, *_):
        pass


def chosen_port():
    try:
        with open(os.path.join(folder, "port")) as file:
            return int(file.read())
    except (OSError, ValueError):
        return 0


server = Server(("127.0.0.1", chosen_port()), Handler)
if len(sys.argv) > 3:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(sys.argv[2], sys.argv[3])
    if len(sys.argv) > 4:
        context.verify_mode = ssl.CERT_REQUIRED
        context.load_verify_locations(sys.argv[4])
    server.socket = context.wrap_socket(server.socket, server_side=True, do_handshake_on_connect=False)
port = os.path.join(folder, "port")
with open(port + ".new", "w") as file:
    file.write(str(server.server_address[1]))
os.replace(port + ".new", port)
print("listening", flush=True)
server.serve_forever()
